"""Reads the animations of a glTF file, and poses its nodes by them.

All animations of the file play together from time 0. Frame 1 is time 0, and there are FPS frames a second. A mesh under
nodes that move is a group; what its nodes do to it must be turning, even scaling and shifting of how the file places it.
Weights of morph targets and skins are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from raygrid.host.scene.animation.keyframes import Keyframes, make_keyframes
from raygrid.host.scene.animation.motions import motion
from raygrid.host.scene.cameras import Camera
from raygrid.host.scene.formats.gltf_document import Document, JsonObject
from raygrid.host.scene.lights import Table, light_table
from raygrid.host.scene.linear_algebra import affine_inverse, determinant, lengths, product
from raygrid.host.scene.pose import FPS, MAX_FRAMES, Pose
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, at_rest, quaternion_of_matrix, rounded, unit_quaternions

WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
UNEVEN = 1e-4  # how far a motion may be from turning and even scaling, as a part of its scale: files hold binary32


@dataclass(frozen=True)
class Spline:
    """A track of CUBICSPLINE keys: values with tangents that come and go, float64 (k, 3, n)."""

    times: F64
    rows: F64

    def at(self, time: float) -> F64:
        """The value at a time, float64 (n,)."""
        after = int(np.searchsorted(self.times, time, side="right"))
        if after == 0 or after == len(self.times):
            return np.array(self.rows[min(after, len(self.times) - 1), 1])
        length = self.times[after] - self.times[after - 1]
        p = float((time - self.times[after - 1]) / length)
        squared, cubed = p * p, p * p * p
        one, other = self.rows[after - 1], self.rows[after]
        return np.asarray(
            (2 * cubed - 3 * squared + 1) * one[1]
            + (cubed - 2 * squared + p) * length * one[2]
            + (3 * squared - 2 * cubed) * other[1]
            + (cubed - squared) * length * other[0]
        )


Motions = dict[tuple[int, str], Keyframes | Spline]


def read_animations(document: Document) -> tuple[Motions, float]:
    """(the track of each node and path that is animated, the time of the last key). Adds nothing to the scene.

    Raises SceneError for tracks that cannot be.
    """
    found: Motions = {}
    last = 0.0
    for number in range(len(document.json.get("animations", ()))):
        row = document.item("animations", number)
        for channel in row["channels"]:
            target = channel["target"]
            if target.get("path") not in WIDTHS or "node" not in target:
                continue
            key = (int(target["node"]), str(target["path"]))
            track, end = _track(document, row["samplers"][channel["sampler"]], key[1], f"animations[{number}]")
            last = max(last, end)
            found.setdefault(key, track)
    return found, last


def _track(document: Document, sampler: JsonObject, path: str, where: str) -> tuple[Keyframes | Spline, float]:
    times = document.accessor(sampler["input"])[:, 0].astype(np.float64)
    values = document.accessor(sampler["output"]).astype(np.float64)
    way = sampler.get("interpolation", "LINEAR")
    each = 3 if way == "CUBICSPLINE" else 1
    if values.shape != (each * len(times), WIDTHS[path]) or len(times) == 0:
        raise document.error(
            f"{where} has {len(times)} times and values of shape {values.shape} for {path}, "
            f"wanted ({each * len(times)}, {WIDTHS[path]})"
        )
    try:
        if way == "CUBICSPLINE":
            make_keyframes(times, values.reshape(len(times), -1))
            return Spline(times, values.reshape(len(times), 3, -1)), float(times[-1])
        if path == "rotation":
            length = lengths(values)[:, None]
            values = np.where(length > 0.0, unit_quaternions(values), (0.0, 0.0, 0.0, 1.0))
        step = "step" if way == "STEP" else "linear"
        return make_keyframes(times, values, step, turns=path == "rotation"), float(times[-1])
    except SceneError as error:
        raise document.error(f"{where}, {path}: {error}") from None


def frames_of(last: float, fps: float = FPS) -> int:
    """Count the frames of an animation whose last key is at this time. Raises SceneError for too many."""
    frames = math.floor(last * fps + 1e-6) + 1
    if frames > MAX_FRAMES:
        raise SceneError(f"the animations last {last:g} s, wanted at most {MAX_FRAMES / fps:g} s")
    return frames


@dataclass(frozen=True)
class Part:
    """A mesh, camera or light of the file: its node, and that node's parents from the root on, with their rows."""

    name: str
    path: tuple[tuple[int, JsonObject], ...]

    def moves(self, motions: Motions) -> bool:
        """Test whether any of the nodes is animated."""
        return any((number, path) in motions for number, _ in self.path for path in WIDTHS)


@dataclass(frozen=True)
class GltfAnimation:
    """Animates the moving parts of a file. `place` gives a node's own matrix, (4, 4), of its row."""

    scene: Scene
    motions: Motions
    place: Callable[[JsonObject], F64]
    groups: tuple[Part, ...]
    camera: Part | None
    lights: tuple[Part, ...]
    make_camera: Callable[[Part, F64], Camera]
    make_light: Callable[[Part, F64], Table]
    exposure: float
    fps: float = FPS

    def pose(self, frame: int) -> Pose:
        """Pose everything. Raises SceneError for what a group cannot do."""
        time = (frame - 1) / self.fps
        motions = [self._motion(part, time) for part in self.groups]
        camera = self.scene.camera if self.camera is None else self.camera_at(self.camera, frame)
        lights = self.scene.lights
        if any(part.moves(self.motions) for part in self.lights):
            lights = light_table([self.make_light(part, self.matrix(part, time)) for part in self.lights])
            lights["intensity"] *= self.exposure
        return Pose(np.stack(motions) if motions else at_rest(0), camera, lights, self.scene.materials)

    def camera_at(self, part: Part, frame: int) -> Camera:
        """The camera of a part in a frame."""
        return self.make_camera(part, self.matrix(part, (frame - 1) / self.fps))

    def matrix(self, part: Part, time: float | None) -> F64:
        """Of a part to the world, (4, 4); without a time as the file places it."""
        whole = np.eye(4)
        for number, row in part.path:
            tracks = {path: self.motions[number, path] for path in WIDTHS if (number, path) in self.motions}
            if time is not None and tracks:
                row = row | {path: track.at(time).tolist() for path, track in tracks.items()}
                row.pop("matrix", None)
            whole = product(whole, self.place(row))
        return whole

    def _motion(self, part: Part, time: float) -> F64:
        rest, now = self.matrix(part, None), self.matrix(part, time)
        try:
            by = product(now, affine_inverse(rest))
        except np.linalg.LinAlgError:
            raise SceneError(f"{part.name} is flattened by its nodes, so it cannot move") from None
        volume = determinant(by[:3, :3])
        if not (math.isfinite(volume) and volume > 0.0):
            raise SceneError(f"{part.name} is turned inside out or shrunk to nothing by its animation")
        scale = rounded.power(volume, 1.0 / 3.0)
        turn = by[:3, :3] / scale
        if np.abs(product(turn.T, turn) - np.eye(3)).max() > UNEVEN:
            raise SceneError(f"{part.name} is scaled unevenly by its animation, wanted the same along all axes")
        return motion(quaternion_of_matrix(turn), scale, by[:3, 3])


def part_names(paths: Sequence[tuple[int, JsonObject]]) -> str:
    """Name a node: by its name, or by its number."""
    number, row = paths[-1]
    return str(row.get("name") or f"nodes[{number}]")
