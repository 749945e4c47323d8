"""PLY: polygons of any shape, every form of the format, and what is said of what cannot be read; against our own writer."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raygrid.host.scene.load import load_scene
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry.surfaces import Kind

CONCAVE = [(0, 0, 0), (4, 0, 0), (4, 4, 0), (2, 1, 0), (0, 4, 0)]  # of area 10; a fan of triangles has 14
FORMS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}

Element = tuple[str, list[str], list[list[Any]]]  # name, properties, rows; a list is a value of a row


def written(form: str, *elements: Element, comments: tuple[str, ...] = (), end: str = "\n") -> bytes:
    """A PLY file."""
    head = ["ply", f"format {form} 1.0", *(f"comment {comment}" for comment in comments)]
    body = b""
    for name, properties, rows in elements:
        head += [f"element {name} {len(rows)}", *(f"property {line}" for line in properties)]
        for row in rows:
            words = []
            for line, value in zip(properties, row, strict=True):
                *kinds, _ = line.removeprefix("list ").split()
                values = [len(value), *value] if isinstance(value, list) else [value]
                kinds = [kinds[0]] + [kinds[-1]] * (len(values) - 1)
                words += [(CODES[kind], value) for kind, value in zip(kinds, values, strict=True)]
            if form == "ascii":
                body += " ".join(str(value) for _, value in words).encode() + end.encode()
            else:
                body += struct.pack(FORMS[form] + "".join(code for code, _ in words), *(value for _, value in words))
    return end.join([*head, "end_header", ""]).encode() + body


def vertices(points: Any, *more: str, rows: list[list[Any]] | None = None) -> Element:
    places = [[float(value) for value in point] for point in points]
    rows = [[]] * len(places) if rows is None else rows
    return "vertex", ["float x", "float y", "float z", *more], [a + b for a, b in zip(places, rows, strict=True)]


def faces(*lists: list[int], name: str = "vertex_indices") -> Element:
    return "face", [f"list uchar int {name}"], [[indices] for indices in lists]


def scene_of(folder: Path, data: bytes) -> Scene:
    (folder / "x.ply").write_bytes(data)
    return load_scene(folder / "x.ply")


def area(scene: Scene) -> float:
    total = 0.0
    for batch in scene.surfaces:
        t = batch.data[:, :9].reshape(-1, 3, 3)
        total += float(np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum()) / 2
    return total


def remarks(scene: Scene) -> list[str]:
    return [remark for remark in scene.remarks if not remark.startswith("no ")]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_concave_polygon_has_its_area(tmp_path: Path, form: str, end: str) -> None:
    scene = scene_of(tmp_path, written(form, vertices(CONCAVE), faces([0, 1, 2, 3, 4]), end=end))
    assert area(scene) == pytest.approx(10)
    assert remarks(scene) == []


@pytest.mark.parametrize("form", FORMS)
def test_other_elements_wherever_they_stand_are_left_out_with_a_remark(tmp_path: Path, form: str) -> None:
    edge: Element = "edge", ["int vertex1", "int vertex2", "uchar red"], [[0, 1, 255], [1, 2, 0]]
    odd: Element = "odd", ["list uint float weights", "short kind"], [[[1.0, 2.0], 3], [[], 4]]
    data = written(form, odd, vertices(CONCAVE), edge, faces([0, 1, 2], [0, 1, 2, 3, 4]), ("z", ["int q"], [[1]]))
    scene = scene_of(tmp_path, data)
    assert len(scene.surfaces) == 4
    assert remarks(scene) == ["elements left out: odd, edge, z"]


@pytest.mark.parametrize("form", FORMS)
def test_a_texture_is_left_out_with_a_remark(tmp_path: Path, form: str) -> None:
    uv = [[0.0, 1.0]] * 5
    data = written(
        form,
        vertices(CONCAVE, "float s", "float t", rows=uv),
        faces([0, 1, 2]),
        comments=("TextureFile a b.png", "by hand"),
    )
    wanted = "the texture 'a b.png' left out: colours of PLY files are those of vertices and faces"
    assert remarks(scene_of(tmp_path, data)) == [wanted]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("kind", "full"), [("uchar", 255), ("ushort", 65535), ("float", 1.0)])
def test_colours_of_faces_and_vertices(tmp_path: Path, form: str, kind: str, full: float) -> None:
    rgb = [f"{kind} {name}" for name in ("red", "green", "blue")]
    red, blue = [full, 0, 0], [0, 0, full]
    scene = scene_of(tmp_path, written(form, vertices(CONCAVE, *rgb, rows=[red] * 5), faces([0, 1, 2])))
    assert np.allclose(scene.materials["diffuse"], [[1, 0, 0]])
    face: Element = "face", ["list uchar uint vertex_index", *rgb], [[[0, 1, 2], *blue], [[0, 2, 4], *red]]
    scene = scene_of(tmp_path, written(form, vertices(CONCAVE), face))
    numbers = scene.surfaces.batches[0].materials
    assert np.allclose(scene.materials["diffuse"][numbers], [[0, 0, 1], [1, 0, 0]])


def test_faces_of_fewer_than_three_vertices_are_left_out_with_a_remark(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, written("binary_big_endian", vertices(CONCAVE), faces([0, 1], [0, 1, 2], [])))
    assert len(scene.surfaces) == 1
    assert remarks(scene) == ["2 faces of fewer than 3 vertices left out"]


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (written("ascii", ("vertex", ["float x"], [[1.0]]), faces([0, 0, 0])), "the vertices have no x, y and z"),
        (written("ascii", vertices(CONCAVE), ("face", ["int a"], [[1]])), "the faces have no list vertex_indices"),
        (written("ascii", vertices(CONCAVE)), "the file has no faces, wanted at least one"),
        (written("ascii", vertices(CONCAVE), faces([0, 1, 5])), "a face has the vertex 5, wanted numbers from 0 to 4"),
        (written("ascii", vertices(CONCAVE), faces([0, 1, -1])), "a face has the vertex -1, wanted"),
        (
            written("binary_little_endian", vertices(CONCAVE), faces([0, 1, 2])).replace(
                b"vertex 5", b"vertex 4000000000"
            ),
            "bytes",
        ),
        (
            written("ascii", vertices(CONCAVE), faces([0, 1, 2])).replace(b"face 1", b"face 4000000000"),
            "lines of data, wanted",
        ),
        (
            b"ply\nformat ascii 1.0\nelement vertex 9\nelement face 9\nend_header\n",
            "the element 'vertex' has no properties",
        ),
        (
            written(
                "binary_little_endian", vertices(CONCAVE), ("face", ["list char char vertex_index"], [[[0, 1, 2]]])
            )[:-4]
            + b"\xff\x00\x01\x02\x00\x01",
            "the PLY file cannot be read",
        ),
        (
            written("ascii", vertices(CONCAVE), faces([0, 1, 2])).replace(b"ascii", b"morse"),
            "the PLY file cannot be read",
        ),
    ],
)
def test_broken_files_are_one_sentence(tmp_path: Path, data: bytes, line: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_of(tmp_path, data)
    text = str(caught.value)
    assert text.startswith(f"{tmp_path / 'x.ply'}: ")
    assert line in text
    assert text.isprintable()


SMALL = st.floats(-100, 100, width=32)
LISTS = st.lists(st.lists(st.integers(0, 5), min_size=3, max_size=7), min_size=1, max_size=8)


@given(st.lists(st.tuples(SMALL, SMALL, SMALL), min_size=6, max_size=6), LISTS)
def test_all_forms_of_a_mesh_are_the_same_scene(
    tmp_path_factory: pytest.TempPathFactory, points: list[tuple[float, float, float]], lists: list[list[int]]
) -> None:
    folder, seen = tmp_path_factory.mktemp("ply"), []
    for form in FORMS:
        try:
            scene = scene_of(folder, written(form, vertices(points), faces(*lists)))
        except SceneError as error:
            seen.append(str(error))
        else:
            assert {batch.kind for batch in scene.surfaces} <= {Kind.TRIANGLE, Kind.SMOOTH}
            seen.append(" ".join(batch.data.tobytes().hex() for batch in scene.surfaces))
    assert len(set(seen)) == 1


@pytest.mark.parametrize("form", FORMS)
def test_a_file_without_vertices_is_refused(tmp_path, form):
    whole = written(form, vertices(CONCAVE), faces([0, 1, 2]))
    with pytest.raises(SceneError, match="lacks vertices or faces, wanted the elements vertex and face"):
        scene_of(tmp_path, whole.replace(b"element vertex", b"element vortex"))


@given(st.sampled_from(list(FORMS)), st.data())
def test_a_file_with_wrong_bytes_is_a_scene_or_one_sentence(
    tmp_path_factory: pytest.TempPathFactory, form: str, data: Any
) -> None:
    whole = bytearray(written(form, vertices(CONCAVE), ("edge", ["int a"], [[1]]), faces([0, 1, 2], [0, 1, 2, 3, 4])))
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    end = data.draw(st.integers(0, len(whole)))
    try:
        scene_of(tmp_path_factory.mktemp("ply"), bytes(whole[:end] if data.draw(st.booleans()) else whole))
    except SceneError as error:
        assert str(error).isprintable()
