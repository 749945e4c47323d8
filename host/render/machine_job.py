"""Makes of a scene and settings what an array needs: world, cells, surfaces and frame in machine coordinates."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.partition import SPLITS
from raygrid.emulator.partition.split import split
from raygrid.host.image.layer_names import checked_layers
from raygrid.host.scene.load import WantsProgram
from raygrid.host.scene.scene import Scene
from raygrid.host.text.misuse import SceneMisuse
from raygrid.node import protocol
from raygrid.node.errors import SceneError
from raygrid.node.geometry import HALF, AddedKind, Moves, Space, SurfaceSet, World, world_around
from raygrid.node.programs import Program

DEFAULT_SIZE = (512, 512)
DEFAULT_DEPTH = 5  # as the Standard Procedural Databases ask
MAX_PIXELS = 1 << 28
FARTHEST = 1e9  # half edges of the world box: rounding there, some 1e-7 of one, is far below render.SURELY_INSIDE


@dataclass(frozen=True)
class Settings:
    """How a scene is to be rendered. None: what the scene's file asks for, else the default.

    size        width and height in pixels (512, 512)
    samples     samples a pixel (1)
    depth       depth of the last hit that is lit; the eye's ray has depth 1 (5)
    min_weight  rays whose largest weight is below this are not born (0)
    highlights  whether materials' highlights are used
    split       "balanced" or "uniform"
    program     that nodes are to run (`raygrid.host.render.program_file`), None for none
    layers      that the picture is to have besides (`raygrid.host.image.layer_names.LAYERS`)
    """

    size: tuple[int, int] | None = None
    samples: int | None = None
    depth: int | None = None
    min_weight: float | None = None
    highlights: bool | None = None
    split: str = "balanced"
    program: Program | None = None
    layers: tuple[str, ...] = ()


@dataclass(frozen=True)
class Job:
    """A scene ready for an array of one shape.

    moves   of a frame of a shot, where its groups are; surfaces in groups are at rest then
    number  of that frame
    load_key  a digest of what an array must hold for it, by which it is not loaded again; "": it is loaded anyway
    add_missed  adds to the sums what a program's background says of rays that never enter the world box; None: this
            process runs the program
    """

    scene: Scene
    world: World
    space: Space
    surfaces: SurfaceSet
    frame: protocol.Frame
    settings: Settings
    moves: Moves | None = None
    number: int | None = None
    load_key: str = ""
    add_missed: Callable[[Job, NDArray[np.int64]], None] | None = None

    @property
    def pixels(self) -> int:
        """How many pixels the picture has."""
        return self.frame.width * self.frame.height


def make_still_job(
    scene: Scene, shape: tuple[int, int, int], settings: Settings, wait: Callable[[], None] | None = None
) -> Job:
    """The job of a scene in which nothing moves. Raises SceneError for settings that cannot be.

    `wait`: as of `raygrid.emulator.partition.split.split`.
    """
    check_settings(scene, settings)
    try:
        world = world_around(scene.surfaces.bounds())
    except SceneError as error:
        raise SceneError(f"{scene.name}: {error}") from None
    surfaces = world.surfaces(scene.surfaces)
    frame = make_frame(scene, world, settings)
    space = split(settings.split, shape, world, surfaces, frame, wait)
    return Job(scene, world, space, surfaces, frame, settings)


def check_settings(scene: Scene, settings: Settings) -> None:
    """Raise WantsProgram for surfaces that nobody can hit without a program, if there is none that does; SceneError for a
    scene without surfaces, for a split that is none, and for layers that are none."""
    program = settings.program
    programmed = scene.surfaces.count(AddedKind.PROGRAMMED)
    if programmed and (program is None or "surface_hits" not in program.hooks):
        raise WantsProgram(f"{scene.name}: {programmed} surfaces of a program came, wanted a program with surface_hits")
    if len(scene.surfaces) == 0:
        raise SceneError(f"{scene.name}: the scene has no surfaces")
    checked_layers(settings.layers)
    if settings.split not in SPLITS:
        raise SceneError(f"a split came as {settings.split!r}, wanted one of {', '.join(SPLITS)}")


def make_frame(scene: Scene, world: World, settings: Settings) -> protocol.Frame:
    """The facts of a frame in machine coordinates. Raises SceneError for settings that cannot be."""
    width, height = _pair(_first(settings.size, scene.size, DEFAULT_SIZE))
    samples = _whole("samples a pixel", _first(settings.samples, scene.samples, 1))
    depth = _whole("depth", _first(settings.depth, scene.depth, DEFAULT_DEPTH))
    asked = any(value is not None for value in (settings.size, settings.samples, settings.depth))
    _check_size(width, height, samples, depth, SceneMisuse if asked else SceneError)
    if len(scene.lights) > protocol.MAX_LIGHTS:
        raise SceneError(f"{scene.name}: {len(scene.lights)} lights came, wanted at most {protocol.MAX_LIGHTS}")
    highlights = scene.highlights if settings.highlights is None else settings.highlights
    least = _first(settings.min_weight, scene.min_weight, 0.0)
    if not (isinstance(least, int | float) and 0.0 <= least < math.inf):
        raise SceneError(f"a least weight came as {least!r}, wanted a finite number of 0 or more")
    materials = scene.materials.copy()
    if not highlights:
        materials["highlight"] = 0.0
    lights = _machine_lights(scene.lights, world)
    with np.errstate(over="ignore"):  # as bright as can be
        background = tuple(float(np.float32(value)) for value in scene.background)
    camera, of_lights = _machine_camera(scene.camera.table(width, height), world), protocol.light_table(lights)
    tables = {"camera": camera, "background": np.array(background), "lights": of_lights}
    for what, table in tables.items():
        if not np.isfinite(table).all():
            raise SceneError(f"{scene.name}: a number of the {what} is not finite, or becomes so at the scene's scale")
    _check_distance(scene.name, camera / (HALF * max(world.step)), width, height)
    return protocol.Frame(
        camera,
        _with_rules(protocol.material_table(materials), scene.rules),
        of_lights,
        len(lights),
        (background[0], background[1], background[2]),
        width,
        height,
        samples,
        depth,
        float(least),
        bool(np.any(lights["cos_disc"] <= 1.0)) if len(lights) else False,
    )


def _check_distance(name: str, camera: NDArray[np.float64], width: int, height: int) -> None:
    """Raise SceneError for rays that begin so far away that rounding moves them by more than nodes and host allow for.

    camera  in half edges of the world box
    """
    ends = camera[0] + np.array([[0.0], [width - 1.0]]) * camera[1], camera[0] + (height - 1.0) * camera[2]
    farthest = float(np.abs(np.concatenate((ends[0], ends[1][None]))).max())
    if farthest > FARTHEST:
        raise SceneError(
            f"{name}: the camera's rays begin {farthest:.3g} times the scene's half size away, wanted at most {FARTHEST:g}: "
            "farther away they have no digits left to tell one from another"
        )


def _with_rules(materials: NDArray[np.float64], rules: NDArray[np.float64] | None) -> NDArray[np.float64]:
    return materials if rules is None else np.ascontiguousarray(np.concatenate((materials, rules), axis=1))


def _first(*choices: Any) -> Any:
    """The first that is not None."""
    return next(choice for choice in choices if choice is not None)


def _pair(size: Any) -> tuple[int, int]:
    try:
        width, height = size
        return operator.index(width), operator.index(height)
    except (TypeError, ValueError):
        raise SceneError(f"a size came as {size!r}, wanted two whole numbers such as (512, 384)") from None


def _whole(what: str, value: Any) -> int:
    try:
        return operator.index(value)
    except TypeError:
        raise SceneError(f"{what} came as {value!r}, wanted a whole number") from None


def _check_size(width: int, height: int, samples: int, depth: int, wrong: type[SceneError]) -> None:
    if not (1 <= width <= protocol.MAX_SIDE and 1 <= height <= protocol.MAX_SIDE and width * height <= MAX_PIXELS):
        raise wrong(
            f"a size came as {width}x{height}, wanted sides of 1 to {protocol.MAX_SIDE} and at most {MAX_PIXELS:,} pixels"
        )
    if samples < 1 or width * height * samples > protocol.MAX_SAMPLES:
        most = protocol.MAX_SAMPLES // (width * height)
        raise wrong(
            f"{samples} samples a pixel came, wanted 1 to {most} for {width}x{height} (sample numbers have 32 bits)"
        )
    if not 1 <= depth <= protocol.MAX_DEPTH:
        raise wrong(f"a depth came as {depth}, wanted 1 to {protocol.MAX_DEPTH}")


def _machine_camera(camera: NDArray[Any], world: World) -> NDArray[np.float64]:
    rows = np.stack([camera[0][name] for name in camera.dtype.names or ()]).astype(np.float64)
    rows[0] = world.points(rows[0])
    rows[1:3] *= world.scale
    return rows


def _machine_lights(lights: NDArray[Any], world: World) -> NDArray[Any]:
    """Point lights move with the scene; an inverse square falls off over machine distances."""
    moved = lights.copy()
    points = moved["kind"] == protocol.POINT
    moved["place"][points] = world.points(moved["place"][points])
    moved["intensity"][moved["falloff"] == 1] *= world.scale**2
    return moved


def rays_enter(job: Job, i: NDArray[np.float64], j: NDArray[np.float64], shrink: float = 0.0) -> NDArray[np.bool_]:
    """Whether the eye's rays through image points (i, j), each (n,), enter the world box, made smaller by
    `shrink` machine units on every side. Plain numpy: it also serves as a check of the nodes' arithmetic."""
    camera = job.frame.camera
    near, far = np.zeros(len(i)), np.full(len(i), np.inf)
    for axis in range(3):  # a column at a time: rows of three are slow
        half = HALF * job.space.step[axis] - shrink
        origin = camera[0, axis] + i * camera[1, axis] + j * camera[2, axis]
        direction = camera[3, axis] + i * camera[4, axis] + j * camera[5, axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (-half - origin) / direction, (half - origin) / direction
        near, far = np.maximum(near, np.fmin(a, b)), np.minimum(far, np.fmax(a, b))
    entered: NDArray[np.bool_] = near <= far
    return entered


def samples_expected(job: Job) -> int:
    """About how many samples enter the world box: from a coarse grid of rays, for the progress bar."""
    frame = job.frame
    across, down = min(frame.width, 64), min(frame.height, 64)
    i = (np.arange(across) + 0.5) * frame.width / across - 0.5
    j = (np.arange(down) + 0.5) * frame.height / down - 0.5
    entered = rays_enter(job, np.tile(i, down), np.repeat(j, across))
    return max(1, math.ceil(np.count_nonzero(entered) / len(entered) * job.pixels * frame.samples))
