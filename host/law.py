"""The law of 1983: the time of a frame on n x n and n x n x n processors, swept in the simulator and fitted.

    square  T = A + B n + C R / n^2        cubic  T = A + B n + C R / n^3

n is the edge of the array, R the number of primary rays. A is there whatever the size, B n grows with the way that
packets go, C R / n^2 is the work of the rays shared out. Fitted by least squares of relative residuals, all of A, B and
C at least 0, with confidence bounds from the covariance of the fit. Needs the extra `law`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.simulator import make_model, trace
from raygrid.host.cost_models import CostModel
from raygrid.host.job import Settings, make_job
from raygrid.host.scene import Scene
from raygrid.node.errors import OutputError
from raygrid.node.packets import PRIMARY
from raygrid.node.tables import BORN, SENT
from raygrid.node.timed import BUSY
from raygrid.node.walk import PORTS

F64 = NDArray[np.float64]
KINDS = {"square": 2, "cubic": 3}  # and how many edges its processors have
CONFIDENCE = 0.95
LEAST_POINTS = 4  # of a fit of three numbers


@dataclass(frozen=True)
class Point:
    """One frame: its array, rays and machine time, and shares of that time."""

    scene: str
    kind: str
    n: int
    shape: tuple[int, int, int]
    rays: int
    ticks: int
    seconds: float
    busy: float
    busiest: float
    hops: int

    @property
    def processors(self) -> int:
        """How many the array has."""
        return self.shape[0] * self.shape[1] * self.shape[2]


@dataclass(frozen=True)
class Fit:
    """What was fitted to the points of one scene and kind.

    values, bounds   A, B and C in seconds, and by how much each may be off at CONFIDENCE (float64 (3,) each)
    r2               of T; residuals float64 (points,): (T - fit) / T
    """

    kind: str
    values: F64
    bounds: F64
    r2: float
    residuals: F64
    points: tuple[Point, ...]

    def time(self, n: Any, rays: Any) -> Any:
        """Seconds by the law."""
        return law(self.kind, n, rays) @ self.values

    def best(self, rays: int) -> float:
        """The edge of the array with the least time by the law; infinite if no part of it grows with n."""
        power = KINDS[self.kind]
        if self.values[1] <= 0.0:
            return np.inf
        return float((power * self.values[2] * rays / self.values[1]) ** (1.0 / (power + 1)))


def law(kind: str, n: Any, rays: Any) -> F64:
    """The three terms without their factors, float64 (..., 3)."""
    n, rays = np.broadcast_arrays(np.asarray(n, np.float64), np.asarray(rays, np.float64))
    return np.stack((np.ones_like(n), n, rays / n ** KINDS[kind]), axis=-1)


def fit(points: Sequence[Point]) -> Fit:
    """Fit the law to points of one kind. Raises OutputError for too few of them, or without scipy."""
    try:
        from scipy.optimize import curve_fit
        from scipy.stats import t as student
    except ImportError:
        raise OutputError("the law needs scipy: pip install 'raygrid[law]'") from None
    kind = points[0].kind
    if len(points) < LEAST_POINTS or len({point.n for point in points}) < LEAST_POINTS - 1:
        raise OutputError(
            f"a fit of the {kind} law came with {len(points)} frames of {len({point.n for point in points})} sizes, "
            f"wanted {LEAST_POINTS} or more of {LEAST_POINTS - 1} sizes"
        )
    times = np.array([point.seconds for point in points])
    terms = law(kind, [point.n for point in points], [point.rays for point in points])
    scale = times.max() / np.maximum(terms.max(axis=0), 1e-300)  # so that the three numbers are of one size

    def model(scaled: F64, *values: float) -> F64:
        return np.asarray(scaled @ np.array(values), np.float64)

    found, covariance = curve_fit(
        model, terms * scale, times, p0=[0.1, 0.1, 0.9], sigma=times, bounds=(0.0, np.inf), x_scale=1.0
    )
    off = np.sqrt(np.clip(np.diag(covariance), 0.0, None)) * student.ppf((1 + CONFIDENCE) / 2, len(points) - 3)
    values, bounds = found * scale, off * scale
    guessed = terms @ values
    spread = float(np.sum((times - times.mean()) ** 2))
    r2 = 1.0 - float(np.sum((times - guessed) ** 2)) / max(spread, 1e-300)
    return Fit(kind, values, bounds, r2, (times - guessed) / times, tuple(points))


def shape_of(kind: str, n: int, along: int) -> tuple[int, int, int]:
    """n processors on each axis; a square array is not divided along axis `along`."""
    if kind == "cubic":
        return n, n, n
    shape = [n, n, n]
    shape[along] = 1
    return shape[0], shape[1], shape[2]


def view_axis(scene: Scene) -> int:
    """The axis along which the camera looks."""
    camera = scene.camera.table(3, 3)[0]
    middle = camera["base"] + camera["base_di"] + camera["base_dj"]
    return int(np.abs(middle).argmax())


def sweep(
    scene: Scene,
    cost: CostModel,
    sizes: dict[str, Sequence[int]],
    pictures: Sequence[tuple[int, int]],
    search: str | None = None,
    along: int | None = None,
    settings: dict[str, Any] | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> list[Point]:
    """Simulate every array size and picture; sizes: kind -> edges. Raises TooLarge, SceneError, ArrayError."""
    chosen = search or cost.file.search
    axis = view_axis(scene) if along is None else along
    points = []
    for kind, edges in sizes.items():
        for n in edges:
            for size in pictures:
                shape = shape_of(kind, n, axis)
                tell(f"{scene.name}: {'x'.join(map(str, shape))}, {size[0]}x{size[1]} pixels")
                points.append(_point(scene, cost, kind, n, shape, size, chosen, settings or {}))
    return points


def _point(
    scene: Scene,
    cost: CostModel,
    kind: str,
    n: int,
    shape: tuple[int, int, int],
    size: tuple[int, int],
    search: str,
    settings: dict[str, Any],
) -> Point:
    job = make_job(scene, shape, Settings(size=size, **{"split": "uniform", **settings}))
    model = make_model(job.space, job.surfaces, job.frame, search)
    phase, _ = trace(model, cost.prices("middle", search), cost.list_ticks("middle", search, model.held))
    busy = phase.column(BUSY) / max(phase.ticks, 1)
    rays, hops = int(phase.total[BORN + PRIMARY]), int(phase.total[SENT : SENT + PORTS].sum())
    seconds = cost.seconds(phase.ticks)
    return Point(
        scene.name, kind, n, shape, rays, phase.ticks, seconds, float(busy.mean()), float(busy.max()), hops
    )


def fits_of(points: Sequence[Point]) -> dict[tuple[str, str], Fit]:
    """A fit for each scene and kind among the points."""
    groups: dict[tuple[str, str], list[Point]] = {}
    for point in points:
        groups.setdefault((point.scene, point.kind), []).append(point)
    return {key: fit(group) for key, group in groups.items()}
