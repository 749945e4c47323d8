"""Reads MTL, the materials of OBJ files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raygrid.host.scene.builder import Table, material, shown
from raygrid.host.scene.file_access import find_bytes
from raygrid.host.scene.textures import Texture, read_picture
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64

GREY = material(diffuse=0.8)  # of meshes that name no material
WHITE = material(diffuse=1.0)  # of those that bring colours

# How many numbers each statement has, in lower case, as some programs write it; everything else is skipped.
STATEMENTS = {b"kd": 3, b"ks": 3, b"tf": 3, b"ns": 1, b"ni": 1, b"d": 1, b"tr": 1, b"illum": 1}
SPECTRUM = (b"spectral", b"xyz")  # other ways to give a colour, which nobody writes
FIRST_MIRROR = 3  # the least `illum` with a reflected ray
GLASS = (4, 6, 7, 9)  # those with transparency


@dataclass(frozen=True)
class Mtl:
    """One material: a row, MATERIAL (1,), and the texture that tints its diffuse colour."""

    row: Table
    texture: Texture | None = None


def read_mtl(path: Path, data: bytes, remarks: list[str]) -> dict[bytes, Mtl]:
    """The materials of a file by name; `data` is what is in it.

    A missing texture is a remark; raises SceneError for numbers that are none.
    """
    found: dict[bytes, Mtl] = {}
    name, values, picture = b"", dict[bytes, F64](), None
    known: dict[bytes, Texture | None] = {}  # pictures, which several materials may share
    lines = data.replace(b"\r", b"\n").split(b"\n")
    for line in [*lines, b"newmtl"]:
        key, *rest = line.split(b"#")[0].split() or (b"",)
        key = key.lower()
        if key == b"newmtl":
            if name:
                found[name] = Mtl(mtl_material(values), _texture(path, picture, remarks, known))
            name, values, picture = b" ".join(rest), {}, None
        elif key == b"map_kd" and rest:
            picture = rest
        elif key in STATEMENTS and rest and rest[0] not in SPECTRUM:
            values[key] = _numbers(path, key, [word for word in rest if word != b"-halo"])
    return found


def mtl_material(values: dict[bytes, F64]) -> Table:
    """The material of MTL's statements (keys in lower case), each an array of its numbers.

    diffuse       Kd, less what is reflected (illum 3 and above) and what passes (d below 1)
    highlight     Ks with exponent Ns, from illum 2 on; none if Ns is 0, as it would be everywhere
    specular      Ks, from illum 3 on
    transmission  1 - d; for the glass of illum 4, 6, 7, 9 with d = 1 the filter Tf if there is one; refracted by Ni

    The format's text adds Ks on top of Kd; taking it off keeps a mirror from giving back more light than it gets.
    """
    illum = int(values.get(b"illum", np.array([2.0]))[0])
    black, white = np.zeros(3), np.ones(3)
    kd = values.get(b"kd", np.full(3, 0.8))
    ks = values.get(b"ks", black) if illum >= 2 else black
    mirror = ks if illum >= FIRST_MIRROR else black
    opaque = float(values[b"d"][0]) if b"d" in values else 1.0 - float(values.get(b"tr", black)[0])
    clear = (1.0 - min(max(opaque, 0.0), 1.0)) * white
    if illum in GLASS and opaque >= 1.0 and b"tf" in values:
        clear = values[b"tf"]
    shine = float(values.get(b"ns", black)[0])
    ior = float(values.get(b"ni", white)[0])
    return material(
        diffuse=np.maximum(kd * (1.0 - mirror) * (1.0 - clear), 0.0),
        highlight=ks if shine > 0.0 else black,
        shine=shine,
        specular=mirror,
        transmission=clear,
        ior=ior if ior > 0.0 else 1.0,
    )


def _numbers(path: Path, key: bytes, words: list[bytes]) -> F64:
    count = STATEMENTS[key]
    if len(words) == 1 and count == 3:
        words = words * 3  # one number stands for three equal ones
    try:
        numbers = np.array([float(word) for word in words[:count]])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) < count or not np.isfinite(numbers).all() or numbers.min() < 0.0:
        came = shown(b" ".join(words).decode("latin-1"))
        wanted = "three finite numbers" if count == 3 else "a finite number"
        raise SceneError(f"{path}: came {key.decode()} {came}, wanted {wanted}, not below 0")
    return numbers


def _texture(
    path: Path, words: list[bytes] | None, remarks: list[str], known: dict[bytes, Texture | None]
) -> Texture | None:
    if words is None:
        return None
    # Options come before the name; then only the last word can be told from them.
    name = words[-1] if words[0].startswith(b"-") else b" ".join(words)
    if name not in known:
        file, data = find_named(path, name.replace(b"\\", b"/"))
        if data is None:
            remarks.append(f"the texture {shown(as_text(name))} is missing: plain colour used")
        known[name] = None if data is None else Texture(read_picture(data, str(file)))
    return known[name]


def find_named(beside: Path, name: bytes) -> tuple[Path, bytes | None]:
    """The file of a name in an OBJ or MTL, and what is in it, None if there is none.

    These formats say not how their names are encoded: what is no UTF-8 is looked for as its bytes are, then as Latin-1,
    which is what programs wrote when file systems had it, too.
    """
    file = beside.parent / name.decode("utf-8", "surrogateescape")
    data = find_bytes(file)
    other = beside.parent / as_text(name)
    return (file, data) if data is not None or other == file else (other, find_bytes(other))


def as_text(name: bytes) -> str:
    """A name out of an OBJ or MTL, for messages."""
    try:
        return name.decode("utf-8")
    except UnicodeDecodeError:
        return name.decode("latin-1")
