"""Fits three laws of a frame's time to some scenes and tells the time of others by them.

    1983        T = A + B n + C R / n^2       (n^3 on cubic arrays): the work shared out evenly
    imbalance   T = A + B n + C I R / n^2     the same, and I is the busiest processor's work by the mean one's
    busiest     T = s W + L + M n             W is the time that the busiest processor works

All three have three numbers of 0 or more, fitted in the same way: least squares of logarithmic residuals, log(T / law), and R^2
is of log T, too. So none is favoured. What a law is worth is told *out of sample*: it is fitted to all scenes but one and tells
the frames of that one. Frames with fewer than FEW_RAYS primary rays a processor are not fitted and are told apart: there the
latency of single rays is the time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.host.machine_time.prediction_law import FEW_RAYS
from raygrid.host.machine_time.scaling_law import KINDS, Point, law, least_squares_of_logs
from raygrid.node.geometry import F64

LEAST_POINTS = 6  # that three numbers are fitted to


class Errors(NamedTuple):
    """What a law is off by, as a factor less 1: log residuals r as exp(|r|) - 1; frames: how many."""

    frames: int
    median: float
    most_of: float  # 95 % lie within
    worst: float


class RivalFit(NamedTuple):
    """One law and the frames of one kind of array.

    values      float64 (3,), by all scenes together; r2: of log T, in sample
    inside      errors of the frames that were fitted
    outside     of fitted frames that are told by others; None: no such frame
    few         of frames with few rays that are told by others, or of all of these if there is a single scene; None: no such
                frame
    told        seconds of each frame of `frames`: by the fit to the other scenes where it is told by others, else to all
    by_others   bool for each frame of `frames`: whether the other scenes have the LEAST_POINTS frames that it takes to fit
    """

    name: str
    kind: str
    values: F64
    r2: float
    inside: Errors
    outside: Errors | None
    few: Errors | None
    frames: tuple[Point, ...]
    told: F64
    by_others: NDArray[np.bool_]


def _of_1983(points: Sequence[Point]) -> F64:
    kind, rays = points[0].kind, [point.rays for point in points]
    return law(KINDS[kind], [point.n for point in points], rays)


def _with_imbalance(points: Sequence[Point]) -> F64:
    terms = _of_1983(points)
    terms[:, 2] *= [point.busiest / max(point.busy, 1e-12) for point in points]
    return terms


def _by_the_busiest(points: Sequence[Point]) -> F64:
    work = [point.busiest * point.seconds for point in points]
    return np.stack((np.array(work), np.ones(len(points)), np.array([float(point.n) for point in points])), axis=-1)


Terms = Callable[[Sequence[Point]], F64]
RIVALS: dict[str, tuple[str, Terms]] = {
    "1983": ("A + B n + C R / n^k", _of_1983),
    "imbalance": ("A + B n + C I R / n^k", _with_imbalance),
    "busiest": ("s W + L + M n", _by_the_busiest),
}


def errors(residuals: F64) -> Errors | None:
    """Errors of logarithmic residuals; None for none."""
    if len(residuals) == 0:
        return None
    off = np.expm1(np.abs(residuals))
    return Errors(len(off), float(np.median(off)), float(np.quantile(off, 0.95)), float(off.max()))


def has_few_rays(point: Point) -> bool:
    """Whether fewer than FEW_RAYS primary rays meet a processor."""
    return point.rays < FEW_RAYS * point.processors


def fit_rival(name: str, points: Sequence[Point]) -> RivalFit | None:
    """Fit one of RIVALS to frames of one kind of array; None if too few of them have rays enough."""
    terms_of = RIVALS[name][1]
    points = [point for point in points if point.seconds > 0.0]
    many = [point for point in points if not has_few_rays(point)]
    if len(many) < LEAST_POINTS:
        return None
    values, residuals = _fitted(terms_of, many)
    told, by_others = _out_of_sample(terms_of, points, many, values)
    logs = np.log([point.seconds for point in points]) - np.log(np.maximum(told, 1e-300))
    few = np.array([has_few_rays(point) for point in points])
    few_told = few if len({point.scene for point in points}) == 1 else few & by_others
    times = np.log([point.seconds for point in many])
    r2 = 1.0 - float(residuals @ residuals) / max(float(np.sum((times - times.mean()) ** 2)), 1e-300)
    inside = errors(residuals)
    assert inside is not None
    outside = errors(logs[by_others & ~few])
    return RivalFit(
        name, points[0].kind, values, r2, inside, outside, errors(logs[few_told]), tuple(points), told, by_others
    )


def _out_of_sample(
    terms_of: Terms, points: Sequence[Point], many: Sequence[Point], values: F64
) -> tuple[F64, NDArray[np.bool_]]:
    """(seconds of each frame by the fit to the other scenes, or by `values` where these are too few; where they suffice)."""
    told, by_others = np.array(terms_of(points) @ values), np.zeros(len(points), np.bool_)
    for scene in dict.fromkeys(point.scene for point in points):
        others = [point for point in many if point.scene != scene]
        if len(others) >= LEAST_POINTS:
            here = np.array([point.scene == scene for point in points])
            told[here] = terms_of([point for point in points if point.scene == scene]) @ _fitted(terms_of, others)[0]
            by_others |= here
    return told, by_others


def _fitted(terms_of: Terms, points: Sequence[Point]) -> tuple[F64, F64]:
    times = np.array([point.seconds for point in points])
    solved = least_squares_of_logs(terms_of(points) / times[:, None])
    return solved.values, solved.residuals


def rivals_of(points: Sequence[Point]) -> list[RivalFit]:
    """Fit every law to each kind of array among the points."""
    found = []
    for kind in KINDS:
        group = [point for point in points if point.kind == kind]
        found += [fit for name in RIVALS if group and (fit := fit_rival(name, group)) is not None]
    return found
