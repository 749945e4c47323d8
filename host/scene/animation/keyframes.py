"""Interpolates values between keyframes.

    linear   straight from key to key
    smooth   cubic from key to key: it starts and ends gently, goes evenly through the keys between, and nowhere beyond
             them (slopes after Fritsch and Butland, "A method for constructing local monotone piecewise cubic
             interpolants", 1984; 0 at the first and last key)
    step     the value of the last key

Before its first key and after its last a value stays what it is there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, slerp

WAYS = ("linear", "smooth", "step")


@dataclass(frozen=True)
class Keyframes:
    """Holds the keyframes of one value.

    frames  float64 (k,), ascending; of a glTF file, seconds
    values  float64 (k, n)
    way     linear, smooth or step
    turns   the values are unit quaternions, between which to go the short way round (always evenly)
    """

    frames: F64
    values: F64
    way: str = "linear"
    turns: bool = False

    def at(self, frame: float) -> F64:
        """Interpolate the value at a frame, float64 (n,)."""
        after = int(np.searchsorted(self.frames, frame, side="right"))
        if after == 0 or after == len(self.frames):
            return np.array(self.values[min(after, len(self.frames) - 1)])
        before = after - 1
        one, other = self.values[before], self.values[after]
        length = self.frames[after] - self.frames[before]
        part = float((frame - self.frames[before]) / length)
        if self.way == "step":
            return np.array(one)
        if self.turns:
            return slerp(one, other, part)
        if self.way == "linear":
            return np.asarray(one + (other - one) * part)
        slope, next_slope = self._slope(before) * length, self._slope(after) * length
        squared, cubed = part * part, part * part * part
        return np.asarray(
            (2 * cubed - 3 * squared + 1) * one
            + (cubed - 2 * squared + part) * slope
            + (3 * squared - 2 * cubed) * other
            + (cubed - squared) * next_slope
        )

    def _slope(self, key: int) -> F64:
        """How fast the value passes a key: 0 at the ends and where it turns back, else a harmonic mean of both sides."""
        if key == 0 or key == len(self.frames) - 1:
            return np.zeros(self.values.shape[1])
        back, ahead = self.frames[key] - self.frames[key - 1], self.frames[key + 1] - self.frames[key]
        came = (self.values[key] - self.values[key - 1]) / back
        goes = (self.values[key + 1] - self.values[key]) / ahead
        first, second = 2.0 * ahead + back, ahead + 2.0 * back
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = (first + second) / (first / came + second / goes)
        return np.where(came * goes > 0.0, mean, 0.0)


def make_keyframes(frames: ArrayLike, values: ArrayLike, way: str = "linear", turns: bool = False) -> Keyframes:
    """Check keys and make keyframes of them. Raises SceneError for keys that are out of order, not finite, or none."""
    at, rows = np.asarray(frames, np.float64), np.asarray(values, np.float64)
    if len(at) == 0 or way not in WAYS:
        raise SceneError(
            f"a track came with {len(at)} keys and the interpolation {way!r}, wanted keys and one of {WAYS}"
        )
    rows = rows.reshape(len(at), -1)
    if not (np.isfinite(at).all() and np.isfinite(rows).all()):
        raise SceneError("a key has a number that is not finite")
    if (np.diff(at) <= 0.0).any():
        key = int(np.argmax(np.diff(at) <= 0.0))
        raise SceneError(
            f"key {key + 1} is at {at[key + 1]:g}, after one at {at[key]:g}: wanted keys in ascending order"
        )
    return Keyframes(at, rows, way, turns)
