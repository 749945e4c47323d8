"""Hostile content of scenes through the service: each file must be refused in one line, and another client's job go on.

Files are written with the seed's numbers in them, so that no two runs of different seeds try the same bytes.
"""

from __future__ import annotations

import json
import os
import random
import struct
import time
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

from faults_bed import SCENES, Case, Outcome
from faults_service import NAME, ServiceBed, Wrong, modest, neighbour, one_line, right, submit

import raygrid
from raygrid.node.errors import RaygridError

SECONDS = 20.0  # in which a hostile scene must be over, with the frames of the neighbour beside it
Make = Callable[[Path, random.Random], Path]  # writes files into a folder; returns the scene

QUAD = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
NFF = "v from 0 0 5 at 0 0 0 up 0 1 0 angle 40 hither 1 resolution 64 48\nl 2 4 4\nf 1 0.5 0.5 0.9 0.3 5 0 1\n"
TOML = """[camera]
from = [0, 0, 5]
at = [0, 0, 0]
fov = 40
[materials.m]
{material}
[[surfaces]]
kind = "sphere"
centre = [0, 0, 0]
radius = 1
material = "m"
"""


def _written(path: Path, data: bytes | str) -> Path:
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


# --- texts ----------------------------------------------------------------------------------------


def _latin(folder: Path, rng: random.Random) -> Path:
    """A texture that is missing, with a name that is no UTF-8: a lone surrogate in the error."""
    name = bytes(rng.choices(range(0xC0, 0x100), k=5))
    _written(folder / "m.mtl", b"newmtl m\nmap_Kd " + name + b".png\n")
    return _written(folder / "s.obj", "mtllib m.mtl\n" + QUAD + "usemtl m\nf 1/1 2/2 3/3 4/4\n")


def _surrogate(folder: Path, rng: random.Random) -> Path:
    """An extension of glTF whose name is a lone surrogate."""
    text = f'{{"asset": {{"version": "2.0"}}, "extensionsRequired": ["\\u{rng.randrange(0xD800, 0xE000):x}"]}}'
    return _written(folder / "s.gltf", text)


def _long_text(folder: Path, rng: random.Random) -> Path:
    """9 MB that come back in an error."""
    text = rng.choice("xyz") * 9_000_000
    if rng.random() < 0.5:
        return _written(folder / "s.gltf", json.dumps({"asset": {"version": "2.0"}, "extensionsRequired": [text]}))
    return _written(folder / "s.nff", f"{text} 1 2 3\n")


def _escapes(folder: Path, rng: random.Random) -> Path:
    """What a terminal would obey, in the name of a material."""
    return _written(folder / "s.nff", NFF + f"\x1b]0;owned{rng.random()}\x07\x1b[2J 0 0 0 1\n")


def _line_breaks(folder: Path, rng: random.Random) -> Path:
    """Lines that look like the project's own, in an error."""
    name = "a\\nraygrid: all is well\\r\\u2028\\u0085" + str(rng.random())
    return _written(folder / "s.gltf", f'{{"asset": {{"version": "2.0"}}, "extensionsRequired": ["{name}"]}}')


def _nul(folder: Path, rng: random.Random) -> Path:
    """A name of a file with a zero byte in it."""
    uri = "a\\u0000b" + str(rng.random())
    return _written(
        folder / "s.gltf", f'{{"asset": {{"version": "2.0"}}, "buffers": [{{"uri": "{uri}", "byteLength": 9}}]}}'
    )


def _not_text(folder: Path, rng: random.Random) -> Path:
    """Bytes of chance under each suffix."""
    suffix = rng.choice(("nff", "toml", "obj", "ply", "glb", "gltf"))
    return _written(folder / f"s.{suffix}", rng.randbytes(rng.choice((0, 1, 12, 5000))))


# --- files that are none --------------------------------------------------------------------------


def _fifo(folder: Path, rng: random.Random) -> Path:
    """A FIFO that nobody writes to: as the scene, a buffer, a texture or a library of materials."""
    what = rng.choice(("scene", "buffer", "texture", "materials"))
    name = {"scene": "s.nff", "buffer": "b.bin", "texture": "t.png", "materials": "m.mtl"}[what]
    os.mkfifo(folder / name)
    return folder / name if what == "scene" else _reader(folder, what, name)


def _device(folder: Path, rng: random.Random) -> Path:
    """A device without an end, by its own path or by a link."""
    what = rng.choice(("buffer", "texture", "materials"))
    target = rng.choice(("/dev/zero", "/dev/urandom"))
    if rng.random() < 0.5:
        return _reader(folder, what, target)
    (folder / "link").symlink_to(target)
    return _reader(folder, what, "link")


def _directory(folder: Path, rng: random.Random) -> Path:
    """A directory where a file should be."""
    (folder / "d").mkdir()
    return _reader(folder, rng.choice(("buffer", "texture", "materials")), "d")


def _loop(folder: Path, rng: random.Random) -> Path:
    """A link to itself."""
    (folder / "l").symlink_to(folder / "l")
    return _reader(folder, rng.choice(("buffer", "texture", "materials")), "l")


def _outside(folder: Path, rng: random.Random) -> Path:
    """A file of the system, read as numbers."""
    way = rng.choice(("/etc/passwd", "../" * 20 + "etc/passwd"))
    return _reader(folder, "buffer", way)


def _reader(folder: Path, what: str, name: str) -> Path:
    """A scene that reads that file."""
    if what == "buffer":
        return _written(folder / "s.gltf", json.dumps(_triangle({"uri": name, "byteLength": 36})))
    if what == "materials":
        return _written(folder / "s.obj", f"mtllib {name}\n{QUAD}usemtl m\nf 1/1 2/2 3/3 4/4\n")
    _written(folder / "m.mtl", f"newmtl m\nmap_Kd {name}\n")
    return _written(folder / "s.obj", f"mtllib m.mtl\n{QUAD}usemtl m\nf 1/1 2/2 3/3 4/4\n")


def _triangle(buffer: dict[str, object]) -> dict[str, object]:
    return {
        "asset": {"version": "2.0"},
        "buffers": [buffer],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0] * 3, "max": [1] * 3}
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }


# --- bombs ----------------------------------------------------------------------------------------


def _deep_key(folder: Path, rng: random.Random) -> Path:
    """A TOML key of very many parts."""
    return _written(folder / "s.toml", ".".join("a" * rng.randrange(40_000, 60_000)) + " = 1\n")


def _deep_list(folder: Path, rng: random.Random) -> Path:
    """Brackets in brackets, as TOML or as JSON."""
    depth = rng.randrange(2_000, 200_000)
    if rng.random() < 0.5:
        return _written(folder / "s.toml", "a = " + "[" * depth + "]" * depth + "\n")
    return _written(folder / "s.gltf", "[" * depth + "]" * depth)


def _huge_number(folder: Path, rng: random.Random) -> Path:
    """A number of very many digits."""
    digits = "9" * rng.randrange(4_400, 60_000)
    if rng.random() < 0.5:
        return _written(folder / "s.toml", f"[image]\nwidth = {digits}\n")
    return _written(folder / "s.nff", NFF + f"s 0 0 0 {digits}\n")


def _large_picture(folder: Path, rng: random.Random) -> Path:
    """A PNG of very many pixels in few bytes."""
    side = rng.randrange(12_000, 60_000)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = zlib.compressobj()
    packed = b"".join(rows.compress(bytes(side // 8 + 1)) for _ in range(side)) + rows.flush()
    head = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    _written(
        folder / "t.png", b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    )
    return _reader(folder, "texture", "t.png")


def _many_corners(folder: Path, rng: random.Random) -> Path:
    """A face of very many corners."""
    corners = rng.randrange(100_000, 180_000)
    lines = [f"v {rng.random():.4f} {rng.random():.4f} 0" for _ in range(corners)]
    return _written(folder / "s.obj", "\n".join(lines) + "\nf " + " ".join(map(str, range(1, corners + 1))) + "\n")


def _large_counts(folder: Path, rng: random.Random) -> Path:
    """Counts of elements that are not there."""
    count = rng.choice((1 << 31, (1 << 63) - 1, 10**30, -5))
    head = f"ply\nformat {rng.choice(('ascii', 'binary_little_endian'))} 1.0\nelement vertex {count}\n"
    return _written(
        folder / "s.ply", head + "property float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
    )


def _sparse_file(folder: Path, rng: random.Random) -> Path:
    """A file of very many bytes that takes no room."""
    suffix = rng.choice(("nff", "obj", "toml", "glb", "ply"))
    with open(folder / f"s.{suffix}", "wb") as file:
        file.truncate(rng.randrange(40, 400) << 30)
    return folder / f"s.{suffix}"


# --- numbers and programs -------------------------------------------------------------------------


def _extreme_ior(folder: Path, rng: random.Random) -> Path:
    """An index of refraction at the end of what numbers can be."""
    ior = rng.choice(("1e16", "1e-30", "1e300", "5e-324", "1e-9"))
    return _written(folder / "s.toml", TOML.format(material=f"transmission = 0.9\nior = {ior}"))


def _extreme_places(folder: Path, rng: random.Random) -> Path:
    """Surfaces at the ends of what numbers can be."""
    rows = [
        f"s {rng.choice((-1, 1)) * 10 ** rng.uniform(-300, 300)} 0 0 {10 ** rng.uniform(-300, 300)}" for _ in range(9)
    ]
    return _written(folder / "s.nff", NFF + "\n".join(rows) + "\n")


CONTENT: dict[str, tuple[Make, ...]] = {
    "texts of scenes": (_latin, _surrogate, _long_text, _escapes, _line_breaks, _nul, _not_text),
    "files that are none": (_fifo, _fifo, _device, _directory, _loop, _outside),
    "bombs": (_deep_key, _deep_list, _huge_number, _large_picture, _many_corners, _large_counts, _sparse_file),
    "numbers at their ends": (_extreme_ior, _extreme_places, _extreme_places),
}


def _hostile(makes: tuple[Make, ...]) -> Callable[[random.Random], list[Case]]:
    def cases(rng: random.Random) -> list[Case]:
        found = []
        for make in makes:
            seed = rng.getrandbits(32)
            found.append(Case(f"{make.__name__.strip('_')} {seed}", partial(_try, make=make, seed=seed)))
        return found

    return cases


def _try(bed: ServiceBed, make: Make, seed: int) -> Outcome:
    """One scene beside a neighbour's job; then the jobs can be listed, and the service be launched anew now and then."""
    folder = bed.root / "hostile"
    bed.empty(folder)
    scene = make(folder, random.Random(seed))
    begun = time.perf_counter()
    with modest(), neighbour(bed), raygrid.connect(NAME) as array:
        job = submit(array, bed.folder / "hostile.npy", scene)
        try:
            job.wait()
            outcome = Outcome("same")
        except RaygridError as error:
            outcome = Outcome("refused", one_line(str(error)))
        facts = next(facts for facts in array.jobs(5) if facts["job"] == job.job)
        if facts["state"] == "failed":
            one_line(facts["error"])
    seconds = time.perf_counter() - begun
    if seconds > SECONDS:
        raise Wrong(f"it took {seconds:.1f} s, wanted at most {SECONDS:g}")
    if seed % 4 == 0:
        bed.down()
        bed.bring_up()
    return outcome


# --- programs -------------------------------------------------------------------------------------

PROGRAMS = {
    "loops": "def tint(point, normal, numbers):\n    x = 0.0\n    while x >= 0.0:\n        x = x + {n}.0\n    return (x, x, x)\n",
    "loops for a numbered ray": (
        "import math\ndef tint(point, normal, numbers):\n    x = 1.0\n    for i in range({n}000000000):\n"
        "        x = math.sin(x + i)\n    return (x, x, x)\n"
    ),
    "raises": "def tint(point, normal, numbers):\n    return (1.0 / (point[0] - point[0]) + {n}, 1.0, 1.0)\n",
    "recurses": "def f(x):\n    return f(x + {n}.0)\ndef tint(point, normal, numbers):\n    x = f(1.0)\n    return (x, x, x)\n",
    "imports": "import os\nN = {n}\ndef tint(point, normal, numbers):\n    return (1.0, 1.0, 1.0)\n",
    "reaches out": "def tint(point, normal, numbers):\n    ().__class__.__base__.__subclasses__()\n    return (1.0, {n}.0, 1.0)\n",
}


def _programs(rng: random.Random) -> list[Case]:
    """Programs that loop, raise or reach for what they must not; the next job has its picture."""

    def do(bed: ServiceBed, text: str) -> Outcome:
        program = bed.root / "hostile.py"
        program.write_text(text)
        with raygrid.connect(NAME) as array:
            job = submit(array, bed.folder / "h.npy", SCENES / "marble.toml", program=program, size=(32, 24), samples=1)
            timer = time.perf_counter()
            try:
                while array.jobs(0) and time.perf_counter() - timer < 6.0:
                    time.sleep(0.05)
                job.cancel()
                job.wait()
                outcome = Outcome("same")
            except RaygridError as error:
                outcome = Outcome("refused", one_line(str(error)))
            begun = time.perf_counter()
            submit(array, bed.folder / "a.npy").wait()
            seconds = time.perf_counter() - begun
        right(bed.folder / "a.npy")
        if seconds > 10.0:
            raise Wrong(f"the next client's frame came {seconds:.1f} s after the program's job was cancelled")
        return outcome

    names = rng.sample(sorted(PROGRAMS), 3)
    return [
        Case(f"a program that {name}", partial(do, text=PROGRAMS[name].format(n=rng.randint(2, 99)))) for name in names
    ]


GROUPS = {**{name: _hostile(makes) for name, makes in CONTENT.items()}, "hostile programs": _programs}
