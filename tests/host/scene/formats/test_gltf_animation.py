"""Node animations of glTF files."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest

from raygrid.host.scene.animation.motions import moved_point
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import SceneError


class Maker:
    """A glTF document with one triangle mesh, and whatever accessors are asked for."""

    def __init__(self):
        self.data = b""
        self.json = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "animations": []}
        corners = self.accessor([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
        self.json["meshes"] = [{"primitives": [{"attributes": {"POSITION": corners}}]}]

    def accessor(self, values):
        values = np.asarray(values, "<f4")
        values = values.reshape(len(values), -1)
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1]]
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        self.data += values.tobytes()
        view = len(self.json["bufferViews"]) - 1
        self.json["accessors"].append({"bufferView": view, "componentType": 5126, "count": len(values), "type": kind})
        return len(self.json["accessors"]) - 1

    def animate(self, node, path, times, values, way="LINEAR"):
        sampler = {"input": self.accessor(times), "output": self.accessor(values), "interpolation": way}
        self.json["animations"].append(
            {"channels": [{"sampler": 0, "target": {"node": node, "path": path}}], "samplers": [sampler]}
        )

    def load(self, tmp_path):
        uri = "data:;base64," + base64.b64encode(self.data).decode()
        self.json["buffers"] = [{"uri": uri, "byteLength": len(self.data)}]
        path = tmp_path / "a.gltf"
        path.write_text(json.dumps(self.json))
        return load_scene(path)


@pytest.fixture
def file():
    return Maker()


def test_a_child_moves_with_its_parents(file, tmp_path):
    """Parent shifts, child rotation_matrices a quarter about z; a third node stays."""
    file.json["nodes"] = [
        {"name": "arm", "children": [1], "translation": [1, 0, 0]},
        {"name": "hand", "mesh": 0, "scale": [2, 1, 1]},
        {"mesh": 0, "translation": [0, 0, 5]},
    ]
    file.animate(0, "translation", [0, 1], [[1, 0, 0], [5, 0, 0]])
    file.animate(1, "rotation", [0, 0.5], [[0, 0, 0, 1], [0, 0, np.sqrt(0.5), np.sqrt(0.5)]])
    scene = file.load(tmp_path)
    shot = scene.shot
    assert (shot.frames, shot.names, shot.fps) == (25, ("hand",), 24.0)
    assert shot.groups.of(np.array([0, 1])).tolist() == [0, -1]
    rest = scene.surfaces.batches[0].data[0].reshape(3, 3)
    assert rest.tolist() == [[1, 0, 0], [3, 0, 0], [1, 1, 0]]
    first, middle, last = (np.array([moved_point(shot.at(f).motions[0], p) for p in rest]) for f in (1, 7, 25))
    assert np.allclose(first, rest)
    assert np.allclose(
        middle, [[2, 0, 0], [2 + np.sqrt(2), np.sqrt(2), 0], [2 - np.sqrt(0.5), np.sqrt(0.5), 0]], atol=1e-6
    )
    assert np.allclose(last, [[5, 0, 0], [5, 2, 0], [4, 0, 0]], atol=1e-6)


def test_step_and_spline(file, tmp_path):
    file.json["nodes"] = [{"mesh": 0}, {"mesh": 0}]
    file.animate(0, "translation", [0, 1], [[0, 0, 0], [4, 0, 0]], "STEP")
    file.animate(
        1, "translation", [0, 1], [[0, 0, 0], [0, 0, 0], [4, 0, 0], [0, 0, 0], [1, 0, 0], [9, 9, 9]], "CUBICSPLINE"
    )
    shot = file.load(tmp_path).shot
    assert shot.at(24).motions[0, 5] == 0.0
    assert shot.at(25).motions[0, 5] == 4.0
    # p = 1/2: (0 + 4/8) from where it came, (1/2) of the end
    assert shot.at(13).motions[1, 5] == pytest.approx(0.5 * 1 + 0.125 * 4)


def test_camera_and_lights_move_too(file, tmp_path):
    file.json["nodes"] = [
        {"mesh": 0},
        {"camera": 0, "translation": [0, 0, 5]},
        {"translation": [0, 3, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
    ]
    file.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 500.0}]}}
    file.animate(1, "translation", [0, 1], [[0, 0, 5], [0, 2, 5]])
    file.animate(2, "translation", [0, 1], [[0, 3, 0], [1, 3, 0]])
    scene = file.load(tmp_path)
    assert scene.shot.at(25).camera.eye == pytest.approx((0, 2, 5))
    lights = scene.shot.at(25).lights
    assert lights["place"][0].tolist() == pytest.approx([1, 3, 0])
    assert lights["intensity"][0].tolist() == pytest.approx(
        scene.lights["intensity"][0].tolist()
    )  # one exposure for all


def test_uneven_scaling_is_an_error_that_names_node_and_frame(file, tmp_path):
    file.json["nodes"] = [{"name": "squash", "mesh": 0}]
    file.animate(0, "scale", [0, 1], [[1, 1, 1], [1, 2, 1]])
    shot = file.load(tmp_path).shot
    shot.at(1)
    with pytest.raises(SceneError, match="frame 9: squash is scaled unevenly by its animation"):
        shot.at(9)


def test_a_node_that_shrinks_to_nothing(file, tmp_path):
    file.json["nodes"] = [{"mesh": 0}]
    file.animate(0, "scale", [0, 1], [[1, 1, 1], [0, 0, 0]])
    with pytest.raises(SceneError, match=r"frame 25: nodes\[0\] is turned inside out or shrunk to nothing"):
        file.load(tmp_path).shot.at(25)


@pytest.mark.parametrize(
    ("times", "values", "said"),
    [
        ([1, 0], [[0, 0, 0], [1, 0, 0]], "ascending"),
        ([0, 1, 2], [[0, 0, 0], [1, 0, 0]], r"3 times and values of shape \(2, 3\)"),
        ([0, np.nan], [[0, 0, 0], [1, 0, 0]], "not finite"),
    ],
)
def test_wrong_animations_are_told(file, tmp_path, times, values, said):
    file.json["nodes"] = [{"mesh": 0}]
    file.animate(0, "translation", times, values)
    with pytest.raises(SceneError, match=said):
        file.load(tmp_path)
