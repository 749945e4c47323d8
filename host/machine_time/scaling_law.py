"""Fits the scaling law of 1983 to frames that are simulated on n x n and n x n x n processors.

    square  T = A + B n + C R / n^2        cubic  T = A + B n + C R / n^3

n is the edge of the array, R the number of primary rays. A is there whatever the size, B n grows with the way that
packets go, C R / n^2 is the work of the rays shared out.

Fitted by least squares of logarithmic residuals, log(T / law), all of A, B and C at least 0, with confidence bounds from
the covariance of the fit; R^2 is that of log T. Times range over three decades, so a second is not the same everywhere;
and residuals divided by T would punish a law twice the time and not one of none, so that the fit would lie under most
frames. With logarithms twice and half the time are equally far off, and the residuals add up to 0. How well the third term
holds is told by a fit in which its power of n is free. Needs the extra `law`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from raygrid.emulator.simulator import make_model, trace
from raygrid.host.machine_time.cost_models import CostModel
from raygrid.host.render.animation_jobs import still_job
from raygrid.host.render.job import Settings
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import OutputError
from raygrid.node.geometry import F64, PORTS
from raygrid.node.protocol import BORN, PRIMARY, SENT

KINDS = {"square": 2, "cubic": 3}  # and how many edges its processors have
CONFIDENCE = 0.95
LEAST_POINTS = 4  # of a fit of three numbers
POWERS = np.arange(0.0, 6.001, 0.02)  # that are tried for the third term
STEPS, LEAST_PART = 200, 2.0**-30  # of a descent: how many, and the least part of one
LEAST_FITTED = 1e-200  # part of T: what a law of zeros is taken for, so that its logarithm is there
ENOUGH = 1e-14  # a step that gains less than this part of the squares is the last


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
        """Count the processors of the array."""
        return self.shape[0] * self.shape[1] * self.shape[2]


@dataclass(frozen=True)
class Fit:
    """Holds the fit to the points of one scene and kind.

    values, bounds   A, B and C in seconds, and by how much each may be off at CONFIDENCE (float64 (3,) each); one that
                     is held at 0 has the bound 0
    r2               of log T, as it was fitted; residuals float64 (points,): log(T / fit)
    power            with which the third term falls with n if that is fitted, too, and the range of it at CONFIDENCE:
                     what a law would be that these frames follow best, 2 or 3 by the law of 1983
    """

    kind: str
    values: F64
    bounds: F64
    r2: float
    residuals: F64
    power: tuple[float, float, float]
    points: tuple[Point, ...]

    def time(self, n: ArrayLike, rays: ArrayLike) -> F64:
        """Seconds by the law."""
        return np.asarray(law(KINDS[self.kind], n, rays) @ self.values)

    @property
    def above(self) -> int:
        """Count the frames that took longer than the law has it."""
        return int(np.count_nonzero(self.residuals > 0.0))

    def best(self, rays: int) -> float:
        """The edge of the array with the least time by the law; infinite if no part of it grows with n."""
        power = KINDS[self.kind]
        if self.values[1] <= 0.0:
            return np.inf
        return float((power * self.values[2] * rays / self.values[1]) ** (1.0 / (power + 1)))


def law(power: float, n: ArrayLike, rays: ArrayLike) -> F64:
    """The three terms without their factors, 1, n and rays / n^power: float64 (..., 3)."""
    size, count = np.broadcast_arrays(np.asarray(n, np.float64), np.asarray(rays, np.float64))
    return np.stack((np.ones_like(size), size, count / size**power), axis=-1)


class Solved(NamedTuple):
    """values (terms,), none below 0; residuals log(T / fit) (points,); slopes: d log(fit) / d values (points, terms)."""

    values: F64
    residuals: F64
    slopes: F64

    @property
    def squares(self) -> float:
        """The sum that is least."""
        return float(self.residuals @ self.residuals)


def _solved(points: Sequence[Point], power: float) -> Solved:
    """Least squares of log(T / fit) with no value below 0. (Other starts than the middle were tried: all end at one place.)"""
    times = np.array([point.seconds for point in points])
    return least_squares_of_logs(
        law(power, [point.n for point in points], [point.rays for point in points]) / times[:, None]
    )


def least_squares_of_logs(over: F64) -> Solved:
    """The values of 0 or more for which log(over @ values) has the least squares; over: terms by T, float64 (points, terms)."""
    over_size = np.exp(np.log(over).mean(axis=0))  # so that each term alone goes through the middle of the points
    values, residuals, slopes = _descended(over / over_size, np.full(over.shape[1], 1.0 / over.shape[1]))
    return Solved(values / over_size, residuals, slopes * over_size)


def _descended(over: F64, values: F64) -> Solved:
    """The least squares of log(over @ values) near a start: Gauss and Newton's steps, each by linear least squares.

    A step solves the problem made linear for values of 0 or more, and so finds those that are 0 exactly; it is halved
    until it does not lead upwards.
    """
    from scipy.optimize import nnls

    def at(values: F64) -> Solved:
        fitted = np.maximum(over @ values, LEAST_FITTED)
        return Solved(values, -np.log(fitted), over / fitted[:, None])

    here = at(values)
    for _ in range(STEPS):
        aim, _ = nnls(here.slopes, 1.0 + here.residuals)  # slopes @ values is 1: log(fit) grows with the values' scale
        part, there = 1.0, at(aim)
        while there.squares > here.squares and part > LEAST_PART:
            part /= 2.0
            there = at(here.values + part * (aim - here.values))
        gained = here.squares - there.squares
        if gained <= 0.0:
            return here
        here = there
        if gained <= ENOUGH * here.squares:
            return here
    return here


def fit(points: Sequence[Point]) -> Fit:
    """Fit the law to points of one kind. Raises OutputError for too few of them, or without scipy."""
    try:
        from scipy.stats import f, t
    except ImportError:
        raise OutputError("the law needs scipy: pip install matplotlib scipy") from None
    kind, sizes = points[0].kind, len({point.n for point in points})
    if len(points) < LEAST_POINTS or sizes < LEAST_POINTS - 1:
        raise OutputError(
            f"a fit of the {kind} law came with {len(points)} frames of {sizes} sizes, "
            f"wanted {LEAST_POINTS} or more of {LEAST_POINTS - 1} sizes"
        )
    if min(point.seconds for point in points) <= 0.0:
        raise OutputError(f"a fit of the {kind} law came with frames that take no time, wanted scenes that rays meet")
    solved = _solved(points, KINDS[kind])
    active = solved.values > 0.0
    freedom = len(points) - int(active.sum())
    bounds = np.zeros(3)
    slopes = solved.slopes[:, active]
    covariance = np.linalg.pinv(slopes.T @ slopes) * solved.squares / freedom
    bounds[active] = np.sqrt(np.diag(covariance)) * t.ppf((1.0 + CONFIDENCE) / 2.0, freedom)
    logs = np.log([point.seconds for point in points])
    r2 = 1.0 - solved.squares / max(float(np.sum((logs - logs.mean()) ** 2)), 1e-300)
    # of the power: all at which the squares are no larger than chance would make them (profile likelihood)
    tried = np.array([_solved(points, power).squares for power in POWERS])
    most = tried.min() * (1.0 + f.ppf(CONFIDENCE, 1, max(freedom - 1, 1)) / max(freedom - 1, 1))
    likely = POWERS[tried <= most]
    power = (float(POWERS[tried.argmin()]), float(likely.min()), float(likely.max()))
    return Fit(kind, solved.values, bounds, r2, solved.residuals, power, tuple(points))


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
    job = still_job(scene, shape, Settings(size=size, **{"split": "uniform", **settings}))
    model = make_model(job.space, job.surfaces, job.frame, search)
    phase, _ = trace(model, cost.prices("middle", search), cost.list_ticks("middle", search, model.holding.held))
    busy = phase.column("busy") / max(phase.ticks, 1)
    rays, hops = int(phase.total[BORN + PRIMARY]), int(phase.total[SENT : SENT + PORTS].sum())
    seconds = cost.seconds(phase.ticks)
    return Point(scene.name, kind, n, shape, rays, phase.ticks, seconds, float(busy.mean()), float(busy.max()), hops)


def fits_of(points: Sequence[Point]) -> dict[tuple[str, str], Fit]:
    """A fit for each scene and kind among the points."""
    groups: dict[tuple[str, str], list[Point]] = {}
    for point in points:
        groups.setdefault((point.scene, point.kind), []).append(point)
    return {key: fit(group) for key, group in groups.items()}
