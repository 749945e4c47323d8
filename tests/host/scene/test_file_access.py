"""The border between scenes and the files of this computer: which they may refer to, how much they may bring, and what
of their text is shown."""

from __future__ import annotations

import base64
import io
import json
import os
import socket
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from support.cli import here, one_line
from support.render import SCENES

from raygrid.host.render.job import Settings
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.sources import recorded
from raygrid.host.service.scene_store import FrameRequest, SceneStore
from raygrid.node.errors import SceneError

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
TEXTURED = "mtllib x.mtl\n" + SQUARE + "usemtl A\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
NFF = "v from 0 -5 1 at 0 0 0 up 0 0 1 angle 40 hither 1 resolution 64 48\ns 0 0 0 1\n"
TRIANGLE = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)


def gltf(uri: str = "x.bin", **more: Any) -> str:
    """A glTF document of one triangle whose buffer lies at a uri."""
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
            "bufferViews": [{"buffer": 0, "byteLength": len(TRIANGLE)}],
            "buffers": [{"uri": uri, "byteLength": len(TRIANGLE)}],
        }
        | more
    )


def png(colour: tuple[int, int, int] = (255, 0, 0)) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.full((2, 2, 3), colour, np.uint8)).save(file, "PNG")
    return file.getvalue()


def refused(path: Path, **options: bool) -> str:
    """The message with which a scene is refused."""
    with pytest.raises(SceneError) as caught:
        load_scene(path, **options)
    text = str(caught.value)
    assert "\n" not in text
    text.encode("utf-8")
    return text


# --- what a scene may refer to: each way of each format to name a file


def scene_that_names(folder: Path, how: str, name: str) -> Path:
    """A scene in a folder that needs the file of that name."""
    folder.mkdir(exist_ok=True)
    texts = {
        "buffer": ("s.gltf", gltf(name)),
        "mtllib": ("s.obj", TEXTURED.replace("x.mtl", name)),
        "map_Kd": ("s.obj", TEXTURED),
        "include": ("s.toml", f"include = {json.dumps(name)}\n"),
        "mesh": ("s.toml", f"[[meshes]]\nfile = {json.dumps(name)}\n"),
    }
    if how == "map_Kd":
        (folder / "x.mtl").write_text(f"newmtl A\nmap_Kd {name}\n")
    file, text = texts[how]
    (folder / file).write_text(text)
    return folder / file


CONTENTS = {
    "buffer": ("f.bin", TRIANGLE),
    "mtllib": ("f.mtl", b"newmtl A\nKd 1 0 0\n"),
    "map_Kd": ("f.png", png()),
    "include": ("f.nff", NFF.encode()),
    "mesh": ("f.obj", TEXTURED.encode()),
}


@pytest.mark.parametrize("how", CONTENTS)
@pytest.mark.parametrize("way", ["absolute", "up", "link", "folder link"])
def test_a_file_outside_the_scenes_folder_is_refused_and_read_if_that_is_allowed(
    tmp_path: Path, how: str, way: str
) -> None:
    file, contents = CONTENTS[how]
    folder, outside = tmp_path / "scene", tmp_path / "scene of another"  # its name begins alike
    folder.mkdir()
    outside.mkdir()
    (outside / file).write_bytes(contents)
    name = {
        "absolute": str(outside / file),
        "up": f"../{outside.name}/{file}",
        "link": file,
        "folder link": f"d/{file}",
    }[way]
    if way == "link":
        (folder / file).symlink_to(outside / file)
    elif way == "folder link":
        (folder / "d").symlink_to(outside)
    if how in ("mtllib", "map_Kd", "buffer"):
        name = name.replace(" ", "%20") if how == "buffer" else name
    scene = scene_that_names(folder, how, name)
    text = refused(scene)
    assert f"the scene refers to a file outside its folder {folder}, wanted one within, or --allow-outside" in text
    assert file in text
    assert len(load_scene(scene, allow_outside=True).surfaces) > 0


@pytest.mark.parametrize("how", CONTENTS)
def test_files_beside_and_below_a_scene_are_read_whatever_the_way_to_them(tmp_path: Path, how: str) -> None:
    file, contents = CONTENTS[how]
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / file).write_bytes(contents)
    for name in (f"below/{file}", f"below/../below/{file}", str(tmp_path / "below" / file)):
        assert len(load_scene(scene_that_names(tmp_path, how, name)).surfaces) > 0


def test_a_mesh_below_a_scene_may_use_what_lies_above_it_within_the_folder(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "x.mtl").write_text("newmtl A\nKd 1 0 0\n")
    (tmp_path / "meshes" / "m.obj").write_text(TEXTURED.replace("x.mtl", "../x.mtl"))
    (tmp_path / "s.toml").write_text('[[meshes]]\nfile = "meshes/m.obj"\n')
    assert np.allclose(load_scene(tmp_path / "s.toml").materials["diffuse"], [[1, 0, 0]])
    assert "outside its folder" in refused(tmp_path / "meshes" / "m.obj")


def test_a_link_to_a_scene_reaches_what_lies_beside_the_scene(tmp_path: Path) -> None:
    there, here_ = tmp_path / "there", tmp_path / "here"
    there.mkdir()
    here_.mkdir()
    (there / "x.mtl").write_text("newmtl A\nKd 1 0 0\n")
    (there / "s.obj").write_text(TEXTURED)
    (here_ / "s.obj").symlink_to(there / "s.obj")
    (here_ / "x.mtl").symlink_to(there / "x.mtl")
    assert np.allclose(load_scene(here_ / "s.obj").materials["diffuse"], [[1, 0, 0]])


def test_what_may_be_missing_and_lies_outside_is_missing(tmp_path: Path) -> None:
    for how in ("mtllib", "map_Kd"):
        remarks = load_scene(scene_that_names(tmp_path, how, "/home/somebody/textures/f.png")).remarks
        assert any("is missing" in remark for remark in remarks)


def test_every_command_that_reads_scenes_takes_allow_outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f.nff").write_text(NFF)
    scene = scene_that_names(tmp_path / "scene", "include", "../f.nff")
    for command in (
        ["info", scene],
        ["export", scene, "-o", "x.pov"],
        ["trace", scene, "--pixel", "1,1", "--size", "4x4"],
        ["jam", scene, "--size", "2x2"],
        ["simulate", scene, "--size", "4x4", "--array", "1x1x1"],
        ["law", scene, "--size", "4x4", "--square", "1,2", "--cubic", "1,2"],
        ["render", scene, "--size", "4x4", "--array", "1x1x1"],
        ["render", scene, "--size", "4x4", "--array", "1x1x1", "--turntable", "2"],
    ):
        outcome = here(*map(str, command))
        assert outcome.code == 1
        assert "outside its folder" in outcome.err
    assert here("info", str(scene), "--allow-outside").code == 0
    assert here("info", str(scene)).code == 1  # it holds for one command
    assert here("export", str(scene), "-o", "x.pov", "--allow-outside").code == 0


# --- only regular files


@pytest.mark.parametrize("how", CONTENTS)
@pytest.mark.parametrize("what", ["FIFO", "device", "socket"])
def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path, how: str, what: str) -> None:
    file = CONTENTS[how][0]
    with socket.socket(socket.AF_UNIX) as listener:
        if what == "FIFO":
            os.mkfifo(tmp_path / file)
        elif what == "device":
            (tmp_path / file).symlink_to("/dev/zero")
        else:
            listener.bind(str(tmp_path / file))
        text = refused(scene_that_names(tmp_path, how, file), allow_outside=True)
    assert f"a {what} came, wanted a regular file" in text


@pytest.mark.parametrize("name", ["s.nff", "s.toml", "s.obj", "s.ply", "s.stl", "s.glb", "s.gltf"])
def test_a_scene_that_is_no_regular_file_is_refused(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    assert refused(tmp_path / name) == f"{tmp_path / name}: a FIFO came, wanted a regular file"


def test_programs_and_cost_models_are_regular_files_too(tmp_path: Path) -> None:
    for name in ("p.py", "c.toml"):
        os.mkfifo(tmp_path / name)
    outcome = here("load", str(tmp_path / "p.py"), "--allow-programs")
    one_line(outcome, 1, "raygrid: .*p.py: a FIFO came, wanted a regular file")
    outcome = here("simulate", str(SCENES / "tiny.nff"), "--cost", str(tmp_path / "c.toml"))
    one_line(outcome, 1, "raygrid: .*c.toml: the cost model cannot be read .a FIFO came, wanted a regular file.")


# --- what was missing


@pytest.mark.parametrize("how", ["mtllib", "map_Kd"])
def test_what_was_looked_for_and_missing_is_among_the_sources(tmp_path: Path, how: str) -> None:
    file, contents = CONTENTS[how]
    path = scene_that_names(tmp_path, how, file)
    with recorded() as sources:
        load_scene(path)
    assert str(tmp_path / file) in sources.files
    assert not sources.changed()
    (tmp_path / file).write_bytes(contents)
    assert sources.changed()
    with recorded() as later:
        load_scene(path)
    assert later.digest() != sources.digest()


def test_a_library_name_with_blanks_is_looked_for_whole_and_in_parts(tmp_path: Path) -> None:
    (tmp_path / "s.obj").write_text(TEXTURED.replace("x.mtl", "a b.mtl"))
    (tmp_path / "b.mtl").write_text("newmtl A\nKd 1 0 0\n")
    with recorded() as sources:
        load_scene(tmp_path / "s.obj")
    assert {Path(name).name for name in sources.files} == {"s.obj", "a b.mtl", "a", "b.mtl"}


def test_a_file_that_was_another_one_when_it_was_read_again_leaves_nothing_to_rely_on(tmp_path: Path) -> None:
    from raygrid.host.scene.file_access import find_bytes

    file = tmp_path / "f"
    with recorded() as sources:
        assert find_bytes(file) is None
        file.write_bytes(b"now it is there")
        assert find_bytes(file) is not None
    assert sources.changed()
    with recorded() as after:
        find_bytes(file)
    assert not after.changed()
    assert sources.digest() != after.digest()
    file.unlink()
    assert sources.changed()


# --- text


EVIL = "\x1b]0;owned\x07\x1b[2J"


@pytest.mark.parametrize(
    "text",
    [
        gltf(extensionsRequired=["\ud800"]),
        gltf(extensionsRequired=[EVIL]),
        gltf(extensionsRequired=["x" * 9_000_000]),
        gltf(EVIL + "\ud800.bin"),
        gltf("nothing" * 100_000),
        gltf(asset={"version": EVIL}),
        gltf(nodes=[{"mesh": EVIL}]),
    ],
)
def test_errors_of_any_text_can_be_shown_and_written(tmp_path: Path, text: str) -> None:
    (tmp_path / "s.gltf").write_text(text)
    message = refused(tmp_path / "s.gltf")
    assert message.isprintable()
    assert len(message) <= 2000


def test_names_in_latin_1_are_shown_and_found(tmp_path: Path) -> None:
    obj = ("mtllib T\xfcr.mtl\n" + SQUARE + "usemtl T\xfcr\nf 1/1 2/2 3/3\n").encode("latin-1")
    (tmp_path / "s.obj").write_bytes(obj)
    remarks = load_scene(tmp_path / "s.obj").remarks
    assert "the material file T\xfcr.mtl is missing: grey used" in remarks
    mtl = "newmtl T\xfcr\nmap_Kd T\xfcr.png\n".encode("latin-1")
    (tmp_path / "T\xfcr.mtl").write_bytes(mtl)
    assert "the texture 'T\xfcr.png' is missing: plain colour used" in load_scene(tmp_path / "s.obj").remarks
    (tmp_path / "T\xfcr.mtl").rename(tmp_path / os.fsdecode("T\xfcr.mtl".encode("latin-1")))
    (tmp_path / "T\xfcr.png").write_bytes(png())
    assert np.allclose(load_scene(tmp_path / "s.obj").materials["diffuse"], [[0.8, 0, 0]])
    (tmp_path / "s.obj").write_bytes(obj.replace(b"usemtl T", b"usemtl S"))
    assert "grey used for unknown materials: S\xfcr" in load_scene(tmp_path / "s.obj").remarks


def test_what_drives_a_terminal_does_not_reach_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.obj").write_text(TEXTURED.replace("x.mtl", EVIL))
    outcome = here("info", "s.obj")
    assert (outcome.code, outcome.out.count("\x1b")) == (0, 0)
    assert "\\x1b]0;owned\\x07" in outcome.out
    (tmp_path / f"{EVIL}.toml").write_text("x = 1")
    outcome = here("info", f"{EVIL}.toml")
    assert (outcome.code, outcome.err.count("\x1b")) == (1, 0)


def test_remarks_are_told_once_and_not_without_end(tmp_path: Path) -> None:
    names = "".join(f"newmtl m{k}\nmap_Kd gone{k}.png\nnewmtl n{k}\nmap_Kd gone{k}.png\n" for k in range(300))
    (tmp_path / "x.mtl").write_text(names)
    (tmp_path / "s.obj").write_text(TEXTURED)
    remarks = load_scene(tmp_path / "s.obj").remarks
    assert len(remarks) == len(set(remarks)) == 101
    assert remarks[-1] == "and 203 remarks more"


# --- how much a scene may bring


def large_png(width: int, height: int) -> bytes:
    """A few kilobytes that say they are so many texels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(8193, 8192), (13_000, 13_000), (60_000, 60_000)])
def test_a_texture_is_measured_before_it_is_decoded(tmp_path: Path, size: tuple[int, int]) -> None:
    scene = scene_that_names(tmp_path, "map_Kd", "x.png")
    (tmp_path / "x.png").write_bytes(large_png(*size))
    text = refused(scene)
    assert "x.png: the texture " in text
    assert "wanted at most 67,108,864" in text


def test_textures_are_measured_together_and_one_that_is_shared_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("raygrid.host.scene.file_access.MOST_TEXELS", 10)
    (tmp_path / "s.obj").write_text(TEXTURED)
    (tmp_path / "a.png").write_bytes(png())
    (tmp_path / "x.mtl").write_text("".join(f"newmtl {k}\nmap_Kd a.png\n" for k in "ABCDE"))
    load_scene(tmp_path / "s.obj")
    for k in "BCDE":
        (tmp_path / f"{k}.png").write_bytes(png())
    (tmp_path / "x.mtl").write_text("".join(f"newmtl {k}\nmap_Kd {k}.png\n" for k in "BCDE"))
    assert "D.png: the scene's textures have more than 10 texels together" in refused(tmp_path / "s.obj")


@pytest.mark.parametrize("contents", [b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", b"no picture"])
def test_no_other_program_is_called_for_a_texture(tmp_path: Path, contents: bytes) -> None:
    scene = scene_that_names(tmp_path, "map_Kd", "x.png")
    (tmp_path / "x.png").write_bytes(contents)
    assert "it is of no format known, wanted one of: PNG JPEG WEBP" in refused(scene)


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 50_000 + " = 1\n",
        "[a" + " . 'b c'" * 60 + "]\n",
        '[[surfaces]]\nx = {"a"' + ' . "a"' * 60 + " = 1}\n",
    ],
)
def test_a_key_has_not_too_many_parts(tmp_path: Path, text: str) -> None:
    (tmp_path / "s.toml").write_text(text)
    assert "has a key of more than 50 parts" in refused(tmp_path / "s.toml")


@pytest.mark.parametrize("text", ["x = " + "9" * 5000, "samples = 0x" + "f" * 5000, "[image]\nwidth = 0x" + "f" * 5000])
def test_numbers_of_thousands_of_digits_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "s.toml").write_text(text)
    refused(tmp_path / "s.toml")


def ring(corners: int, out: float) -> list[tuple[float, float, float]]:
    """A polygon around the origin; every other corner is so much further out."""
    at = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    far = 1.0 + out * (np.arange(corners) % 2)
    return [(float(r * np.cos(t)), float(r * np.sin(t)), 0.0) for r, t in zip(far, at, strict=True)]


@pytest.mark.parametrize("suffix", ["obj", "ply", "nff", "toml"])
def test_a_polygon_has_not_more_corners_than_can_be_worked_on(tmp_path: Path, suffix: str) -> None:
    points = ring(5002, 0.5)
    lines = [f"{x} {y} {z}" for x, y, z in points]
    numbers = " ".join(map(str, range(1, len(points) + 1)))
    text = {
        "obj": "".join(f"v {line}\n" for line in lines) + f"f {numbers}\n",
        "ply": f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list int int vertex_indices\nend_header\n"
        + "\n".join(lines)
        + f"\n{len(points)} {' '.join(map(str, range(len(points))))}\n",
        "nff": NFF + f"p {len(points)}\n" + "\n".join(lines) + "\n",
        "toml": f'[[surfaces]]\nkind = "polygon"\npoints = {[list(point) for point in points]}\n',
    }[suffix]
    (tmp_path / f"s.{suffix}").write_text(text)
    assert "has 5,002 corners, wanted at most 5,000" in refused(tmp_path / f"s.{suffix}")


def test_a_convex_face_may_have_any_number_of_corners(tmp_path: Path) -> None:
    lines = "".join(f"v {x} {y} {z}\n" for x, y, z in ring(20_000, 0.0))
    (tmp_path / "s.obj").write_text(lines + f"f {' '.join(map(str, range(1, 20_001)))}\n")
    assert len(load_scene(tmp_path / "s.obj").surfaces) == 19_998


def test_a_mesh_that_is_placed_over_and_over_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("raygrid.host.scene.builder.MOST_NUMBERS", 100)
    (tmp_path / "m.obj").write_text(TEXTURED)
    (tmp_path / "s.toml").write_text('[[meshes]]\nfile = "m.obj"\n' * 6)
    assert len(load_scene(tmp_path / "m.obj").surfaces) == 2
    assert "s.toml: the surfaces have more than 100 numbers together" in refused(tmp_path / "s.toml")


def test_files_have_a_length_at_most_each_and_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_that_names(tmp_path, "buffer", "x.bin")
    with open(tmp_path / "x.bin", "wb") as file:
        file.truncate((1 << 30) + 1)
    assert "x.bin: the file has 1,073,741,825 bytes or more, wanted at most 1,073,741,824" in refused(scene)
    (tmp_path / "x.bin").write_bytes(TRIANGLE)
    monkeypatch.setattr("raygrid.host.scene.file_access.MOST_BYTES", scene.stat().st_size + 10)
    assert "x.bin: with this file the scene has more than" in refused(scene)


def chain(many: int) -> list[dict[str, Any]]:
    """Nodes below each other, a mesh at the bottom."""
    return [{"children": [k + 1]} for k in range(many - 1)] + [{"mesh": 0}]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (gltf(nodes=chain(201)), "nodes[200] lies below 200 others, wanted fewer"),
        (gltf(extras=[[0] * 1000] * 17_000), "the JSON has 17,"),
        (gltf("x" * 20_000), "buffers[0].uri has 20,000 characters, wanted the name of a file"),
        (gltf("data:," + "%41" * 6_000_000), "buffers[0].uri has 18,000,000 characters, wanted base64"),
        (
            gltf(accessors=[{"componentType": 5126, "count": 10**8, "type": "VEC3"}]),
            "has 100000000 values and no bufferView",
        ),
        (
            gltf(bufferViews=[{"buffer": 0, "byteLength": len(TRIANGLE), "byteStride": 1}]),
            "accessors[0] has values of 12 bytes every 1 bytes, wanted them apart",
        ),
    ],
    ids=range(6),
)
def test_gltf_documents_have_limits(tmp_path: Path, text: str, line: str) -> None:
    (tmp_path / "s.gltf").write_text(text)
    (tmp_path / "x.bin").write_bytes(TRIANGLE)
    assert line in refused(tmp_path / "s.gltf")
    (tmp_path / "s.gltf").write_text(gltf(nodes=chain(200)))
    assert len(load_scene(tmp_path / "s.gltf").surfaces) == 1


def test_gltf_textures_may_be_webp_alone_and_are_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = io.BytesIO()
    Image.fromarray(np.full((2, 2, 3), (255, 0, 0), np.uint8)).save(file, "WEBP", lossless=True)
    uri = "data:image/webp;base64," + base64.b64encode(file.getvalue()).decode()
    monkeypatch.setattr("raygrid.host.scene.file_access.MOST_TEXELS", 4)
    attributes, buffer = {"POSITION": 0, "TEXCOORD_0": 1}, TRIANGLE + struct.pack("<6f", *(0.5,) * 6)
    text = gltf(
        extensionsUsed=["EXT_texture_webp"],
        extensionsRequired=["EXT_texture_webp"],
        meshes=[{"primitives": [{"attributes": attributes, "material": k} for k in range(3)]}],
        materials=[{"pbrMetallicRoughness": {"metallicFactor": 0, "baseColorTexture": {"index": 0}}} for _ in range(3)],
        textures=[{"extensions": {"EXT_texture_webp": {"source": 0}}}],
        images=[{"uri": uri}],
        accessors=[
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": kind, "byteOffset": at}
            for kind, at in (("VEC3", 0), ("VEC2", len(TRIANGLE)))
        ],
        bufferViews=[{"buffer": 0, "byteLength": len(buffer)}],
        buffers=[{"uri": "x.bin", "byteLength": len(buffer)}],
    )
    (tmp_path / "x.bin").write_bytes(buffer)
    (tmp_path / "s.gltf").write_text(text)
    assert np.allclose(load_scene(tmp_path / "s.gltf").materials["diffuse"], [[1, 0, 0]])


@pytest.mark.parametrize("how", ["mtllib", "map_Kd"])
def test_the_scene_that_an_array_keeps_is_read_anew_when_what_was_missing_has_come(tmp_path: Path, how: str) -> None:
    file, contents = CONTENTS[how]
    path, store = str(scene_that_names(tmp_path, how, file)), SceneStore((1, 1, 1))
    wanted = FrameRequest(path, Settings(size=(8, 8)))
    before = store.frame(wanted, None)
    assert store.frame(wanted, None) is before
    (tmp_path / file).write_bytes(contents)
    after = store.frame(wanted, None)
    assert after.contents != before.contents
    assert after.digest(None, "srgb") != before.digest(None, "srgb")
    assert any("is missing" in remark for remark in before.remarks)
    assert not any("is missing" in remark for remark in after.remarks)


@pytest.mark.parametrize("allowed", [False, True])
def test_an_array_that_stays_reads_outside_as_whoever_started_it_decided(tmp_path: Path, allowed: bool) -> None:
    (tmp_path / "f.nff").write_text(NFF)
    scene = scene_that_names(tmp_path / "scene", "include", "../f.nff")
    store = SceneStore((1, 1, 1), allowed)
    if allowed:
        assert len(store.scene(str(scene))[1].surfaces) == 1
    else:
        with pytest.raises(SceneError, match="wanted one within, or raygrid up --allow-outside for scenes"):
            store.scene(str(scene))
