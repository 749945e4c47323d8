"""Scenes from elsewhere: the camera that is asked for, all in the picture from every side, lights, shots, and what cannot be."""

import json
from pathlib import Path

import numpy as np
import pytest
from support import paths
from support.render import shared

from raygrid.host.scene.cameras import DEFAULT_FOV
from raygrid.host.scene.finish import MANY_CAMERAS, NO_CAMERA, NO_LIGHT
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.view import FITS
from raygrid.host.text.misuse import SceneMisuse

SCENES = paths.SCENES
GLASS, MOBILE, TINY, ROOM = (SCENES / name for name in ("glass.toml", "mobile.toml", "tiny.nff", "room.obj"))
TILTED = "v 0 0 0\nv 4 0 0\nv 0 2 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def wedge(tmp_path):
    path = tmp_path / "wedge.obj"
    path.write_text(TILTED)
    return path


def test_a_camera_stands_looks_and_opens_as_it_is_told():
    camera = load_scene(GLASS, eye=(1, 2, 9), at=(1, 2, 0), up=(1, 0, 0), fov=90).camera
    assert camera.eye == (1.0, 2.0, 9.0)
    assert np.allclose((camera.forward, camera.up), ((0, 0, -1), (1, 0, 0)))
    assert camera.half == pytest.approx(1.0)


def test_what_is_not_said_of_a_camera_stays():
    own = load_scene(GLASS).camera
    wider = load_scene(GLASS, fov=60).camera
    assert (wider.eye, wider.up) == (own.eye, pytest.approx(own.up))
    assert wider.forward == pytest.approx(own.forward)
    moved = load_scene(GLASS, at=(0, 0, 0)).camera
    assert (moved.eye, moved.half) == (own.eye, own.half)
    alone = load_scene(GLASS, eye=(50, 0, 0))
    middle = alone.surfaces.bounds().mean(axis=0)
    assert np.allclose(np.cross(middle - (50, 0, 0), alone.camera.forward), 0.0, atol=1e-9)


def projected(scene):
    """Where the corners of the scene's box lie in a square picture, its sides at 1, (8, 2)."""
    camera, bounds = scene.camera, scene.surfaces.bounds()
    corners = np.array([[x, y, z] for x in bounds[:, 0] for y in bounds[:, 1] for z in bounds[:, 2]]) - camera.eye
    seen = np.stack((corners @ camera.right, corners @ camera.up), axis=1) / camera.half
    deep = corners @ camera.forward
    assert deep.min() > -1e-9
    return seen if camera.orthographic else seen / deep[:, None]


@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("up", [None, (0, 0, 1), (1, 0, 0), (1, 2, 3)])
def test_all_of_a_scene_is_in_the_picture_and_fills_it(wedge, fit, up):
    seen = projected(load_scene(wedge, fit=fit, up=up))
    assert 0.9 < np.abs(seen).max() < 1.0


SIDES = [("front", (0, 0, -1), (0, 1, 0)), ("back", (0, 0, 1), (0, 1, 0)), ("left", (1, 0, 0), (0, 1, 0)),
         ("right", (-1, 0, 0), (0, 1, 0)), ("top", (0, -1, 0), (0, 0, -1)), ("bottom", (0, 1, 0), (0, 0, 1))]  # fmt: skip


@pytest.mark.parametrize(("fit", "forward", "up"), SIDES)
def test_sides_are_those_of_the_world(fit, forward, up):
    camera = load_scene(GLASS, fit=fit).camera
    assert np.allclose((camera.forward, camera.up), (forward, up))


def test_the_front_is_minus_y_where_z_is_up(tmp_path, wedge):
    import trimesh

    path = tmp_path / "w.stl"
    path.write_bytes(trimesh.load(wedge).export(file_type="stl"))
    assert np.allclose(np.abs(load_scene(path, fit="front").camera.forward), (0, 1, 0))
    assert np.allclose(load_scene(path, fit="top").camera.forward, (0, 0, -1))


def test_the_cow_is_seen_from_its_front():
    cow = load_scene(shared("meshes", "spot_triangulated.obj"))
    assert cow.front == (0.0, 0.0, -1.0)  # where its face is
    assert cow.camera.eye[2] < cow.surfaces.bounds()[0, 2]
    assert load_scene(ROOM).front == (0.0, 0.0, 1.0)  # the open side of the room


def test_lights_that_were_invented_go_with_the_camera(wedge):
    front, back = load_scene(wedge, fit="front"), load_scene(wedge, fit="back")
    assert (front.lights["place"][:, 2] > 0).any()
    assert np.allclose(front.lights["place"] * (-1, 1, -1), back.lights["place"])
    assert (load_scene(GLASS, fit="back").lights == load_scene(GLASS).lights).all()


def test_lights_and_background_take_the_place_of_the_scenes(wedge):
    scene = load_scene(wedge, lights=[(1, 2, 3), (4, 5, 6, 0.1, 0.2, 0.3)], background=(0.5, 0.25, 0))
    assert scene.lights["place"].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert np.allclose(scene.lights["intensity"], ((1, 1, 1), (0.1, 0.2, 0.3)))
    assert scene.background == (0.5, 0.25, 0.0)
    assert NO_LIGHT not in scene.remarks
    assert NO_CAMERA in scene.remarks
    assert NO_CAMERA not in load_scene(wedge, fit="top").remarks


def test_a_wider_view_of_an_invented_camera_still_shows_all(wedge):
    own, wide = load_scene(wedge), load_scene(wedge, fov=80)
    assert 0.9 < np.abs(projected(wide)).max() < 1.0
    assert np.linalg.norm(wide.camera.eye) < np.linalg.norm(own.camera.eye)
    assert load_scene(wedge, fov=DEFAULT_FOV).camera == own.camera


def two_cameras(folder: Path, moving: bool) -> Path:
    """A triangle and two cameras, the second of which may move to the right."""
    import base64

    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
    times, places = np.array([0, 1], np.float32).tobytes(), np.array([[0, 0, 5], [3, 0, 5]], np.float32).tobytes()
    data = points + times + places
    views = [(0, 36), (36, 8), (44, 24)]
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteOffset": at, "byteLength": size} for at, size in views],
        "accessors": [{"bufferView": k, "componentType": 5126, "count": n, "type": kind}
                      for k, (n, kind) in enumerate(((3, "VEC3"), (2, "SCALAR"), (2, "VEC3")))],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}},
                    {"type": "perspective", "perspective": {"yfov": 0.9, "znear": 0.1}}],
        "nodes": [{"mesh": 0}, {"camera": 0, "translation": [0, 0, 9]}, {"camera": 1, "name": "side", "translation": [0, 0, 5]}],
    }  # fmt: skip
    if moving:
        channel = {"sampler": 0, "target": {"node": 2, "path": "translation"}}
        document["animations"] = [{"channels": [channel], "samplers": [{"input": 1, "output": 2}]}]
    path = folder / "two.gltf"
    path.write_text(json.dumps(document))
    return path


def test_a_camera_is_chosen_by_name_or_number(tmp_path):
    path = two_cameras(tmp_path, False)
    plain = load_scene(path)
    assert [camera.name for camera in plain.cameras] == ["", "side"]
    assert any(MANY_CAMERAS in remark and "1, 'side'" in remark for remark in plain.remarks)
    for asked in ("side", 2, "2"):
        chosen = load_scene(path, camera=asked)
        assert chosen.camera.eye == (0.0, 0.0, 5.0)
        assert not any(MANY_CAMERAS in remark for remark in chosen.remarks)
    assert load_scene(path, camera=1).camera == plain.camera
    assert load_scene(path, camera="side", fov=20).camera.half == pytest.approx(np.tan(np.radians(10)))


def test_cameras_of_a_placed_mesh_are_no_matter(tmp_path):
    """It failed: --camera was said to choose another, and was refused then."""
    two_cameras(tmp_path, False)
    (tmp_path / "x.toml").write_text('[[meshes]]\nfile = "two.gltf"\n')
    assert [remark.partition(":")[0] for remark in load_scene(tmp_path / "x.toml").remarks] == [
        "no camera in the file",
        "no light in the file",
    ]


def test_a_chosen_camera_moves_as_the_file_has_it_and_one_that_is_told_stays(tmp_path):
    path = two_cameras(tmp_path, True)
    side = load_scene(path, camera="side").shot
    assert side.at(1).camera.eye == (0.0, 0.0, 5.0)
    assert side.at(side.frames).camera.eye == pytest.approx((3.0, 0.0, 5.0))
    assert load_scene(path, camera=1).shot.at(9).camera.eye == (0.0, 0.0, 9.0)
    fitted = load_scene(MOBILE, fit="top")
    assert fitted.shot.at(1).camera == fitted.shot.at(30).camera == fitted.camera
    own = load_scene(MOBILE)
    assert load_scene(MOBILE, camera=1).shot.at(30).camera == own.shot.at(30).camera
    assert (fitted.shot.at(30).motions == own.shot.at(30).motions).all()
    lit = load_scene(MOBILE, lights=[(1, 2, 3)])
    assert len(lit.shot.at(30).lights) == 1
    assert lit.shot.at(30).camera == own.shot.at(30).camera


@pytest.mark.parametrize(
    ("view", "words"),
    [
        ({"eye": (1, 2, 3), "at": (1, 2, 3)}, r"wedge.obj: the camera looks from \(1, 2, 3\) at that same point"),
        ({"eye": (0, 5, 0), "at": (0, 0, 0)}, r"wedge.obj: the camera's up \(0, 1, 0\) is parallel to its view"),
        ({"camera": 1}, "wedge.obj: camera came as 1, but the scene has none; wanted --fit or --from"),
    ],
)
def test_a_camera_that_shows_nothing_is_refused(wedge, view, words):
    with pytest.raises(SceneMisuse, match=words):
        load_scene(wedge, **view)


def test_an_unknown_camera_is_told_with_those_that_there_are(tmp_path):
    with pytest.raises(SceneMisuse, match=r"two.gltf: camera came as 'top', wanted one of: 1, 2 'side'"):
        load_scene(two_cameras(tmp_path, False), camera="top")
    with pytest.raises(SceneMisuse, match=r"tiny.nff: camera came as 2, wanted one of: 1$"):
        load_scene(TINY, camera=2)


def test_an_unknown_keyword_is_a_type_error():
    with pytest.raises(TypeError, match=r"load_scene came with \['zoom'\], wanted some of eye, at"):
        load_scene(TINY, zoom=3)


def test_a_scene_that_was_read_takes_a_view_but_no_crease():
    scene = load_scene(TINY)
    assert load_scene(scene) is scene
    assert load_scene(scene, fit="top").camera == load_scene(TINY, fit="top").camera
    with pytest.raises(SceneMisuse, match="a crease came for a scene that was read already"):
        load_scene(scene, crease=10)
