"""The border between scenes and the files of this computer: which they may refer to, how much they may bring, and what
of their text is shown."""

from __future__ import annotations

import io
import json
import os
import socket
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from support_cli import here, one_line
from support_render import SCENES

from raygrid.host.load import load_scene
from raygrid.host.sources import recorded
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
    from raygrid.host.scene_files import find_bytes

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
