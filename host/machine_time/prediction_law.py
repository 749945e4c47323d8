"""Extrapolates the time of a phase from two small pictures of it: T = share x W + latency, and what that may be off by.

W is the most that any processor has to do. *The frame takes as long as the busiest processor works* is the law; what is left
are the share by which that one waits for others while there is work, which does not depend on the number of rays, and the
latency, the time before its first packet and after its last, which grows with nothing. Two pictures with different numbers of
rays tell both. The share is 1 or more, the latency 0 or more, because nobody is done before the busiest processor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raygrid.node.geometry import F64

FEW_RAYS = 10.0  # of primary rays for a processor: below, the latency of single rays tells, and not the work
LIKELY = 2.0  # how many standard errors a stated error is
LEAST_ERROR, LEAST_ERROR_FEW = 0.005, 0.05  # what the law is off by at least, by many rays and by few
DOUBT = 0.05  # part of the growth of a latency that is stated as an error
MOST_POWER = 16.0


class WorkShare(NamedTuple):
    """T = share x W + latency, the latter in the unit of T."""

    share: float
    latency: float


def share_of(small: tuple[float, float], large: tuple[float, float], least: float = 1.0) -> WorkShare:
    """The line through two pictures, each (W, T), with a share of `least` or more and a latency of 0 or more."""
    (less, sooner), (more, later) = small, large
    if more <= 0.0:
        return WorkShare(least, max(later, 0.0))
    slope = (later - sooner) / (more - less) if more > less else least
    share = min(max(slope, least), max(later / more, least))
    return WorkShare(share, max(later - share * more, 0.0))


def shrunk_latency(latency: float, longest: float, seen: float, work: float) -> float:
    """What is left of a latency when there is more work than in the picture that told it.

    By (W^p + S^p)^(1/p) = W + latency, a largest of two that is rounded off: where W is small, the time is that of the
    sample that takes longest, S, and where it is large W hides it. p follows from the latency at W = seen; never below 1.
    """
    if latency <= 0.0 or longest <= 0.0 or seen <= 0.0 or work <= seen:
        return latency
    if latency >= longest:
        return latency

    def over(power: float, at: float) -> float:
        return float(at * ((1.0 + (longest / at) ** power) ** (1.0 / power) - 1.0))

    low, high = 1.0, MOST_POWER
    if over(high, seen) >= latency:  # the rounding is as sharp as can be
        return latency if longest > seen and work <= latency else over(high, work)
    for _ in range(60):
        middle = (low + high) / 2.0
        low, high = (middle, high) if over(middle, seen) > latency else (low, middle)
    return over(high, work)


def jackknifed(groups: F64) -> tuple[float, float]:
    """(the most of any cell, its relative standard error) from the work of groups of samples, float64 (cells, groups).

    By the jackknife (Quenouille 1949, Tukey 1958): the most is worked out anew without each of the groups. So it counts
    that another cell might be the busiest.
    """
    many = groups.shape[1]
    whole = groups.sum(axis=1)
    most = float(whole.max())
    if most <= 0.0:
        return 0.0, 0.0
    without = np.array([(whole - groups[:, k]).max() for k in range(many)]) * (many / (many - 1.0))
    return most, float(np.sqrt((many - 1.0) / many * np.sum((without - without.mean()) ** 2)) / most)


class Extrapolated(NamedTuple):
    """A time, and by what part of itself it may be off; latency: what of it is not share x W."""

    time: float
    error: float
    latency: float


def extrapolated(
    law: WorkShare, large: tuple[float, float], longest: float, work: tuple[float, float], few: bool
) -> Extrapolated:
    """The time of a frame from what two pictures told.

    large    (W, T) of the larger picture; longest: S, the time of the sample that takes longest if it meets no other
    work     W of the frame, and its relative standard error
    few      few rays meet many processors

    The latency is put half way between what it was and what would be left of it by `shrunk_latency`, and half of the
    difference is stated as an error; so is a part of what T would be more if the latency had grown with the work.
    """
    most, standard = work
    shrunk = shrunk_latency(law.latency, longest, large[0], most)
    latency = (law.latency + shrunk) / 2.0
    time = law.share * most + latency
    if time <= 0.0:
        return Extrapolated(0.0, 0.0, 0.0)
    doubt = abs(law.latency - shrunk) / 2.0 / time
    grown = DOUBT * max(large[1] / max(large[0], 1.0) * most - time, 0.0) / time
    least = LEAST_ERROR_FEW if few else LEAST_ERROR
    error = float(np.sqrt((LIKELY * standard) ** 2 + doubt**2 + grown**2 + least**2))
    return Extrapolated(time, error, latency)
