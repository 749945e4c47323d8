"""Converts cameras from the ways in which files describe them to the linear form that the nodes use.

Every camera is an eye, three perpendicular unit vectors and half the height of its view. With square pixels the
picture's width and height then give one number, the pitch from pixel to pixel, and pixel (i, j) looks along

    forward + pitch * (i - (w - 1) / 2) * right + pitch * ((h - 1) / 2 - j) * up        (perspective)

An orthographic camera moves its eye by the same offsets and looks along `forward`. What differs between files is only
which length the half height spans (`Span`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raygrid.host.scene.linear_algebra import dot, lengths
from raygrid.node.errors import SceneError
from raygrid.node.geometry import rounded
from raygrid.node.protocol import CAMERA_RECORD

Vector = tuple[float, float, float]

DEFAULT_FOV = 40.0  # degrees, vertical: a moderate lens for cameras that no file describes
# degrees: of a wider view the axis is so short beside its width that rounding takes it away
WIDEST = 179.99
FRAME_MARGIN = 1.08  # the box of a scene fills the picture but for this much


class Span(Enum):
    """Names the length across which the height (or angle) of a view is measured."""

    MIDDLES = "middles"  # the middle of the first pixel row to the middle of the last (NFF)
    EDGES = "edges"  # the upper edge of the picture to the lower (glTF, and most others)
    NARROW = "narrow"  # edge to edge of the shorter side, so that a tall picture shows as much as a wide one


@dataclass(frozen=True)
class Camera:
    """A camera in scene coordinates.

    eye                 where rays start (orthographic: the middle of the window where they start)
    forward, right, up  perpendicular unit vectors; right and up are those of the picture
    half                perspective: tangent of half the angle; orthographic: half the height, scene units
    span                what `half` is measured across
    orthographic        parallel rays
    """

    eye: Vector
    forward: Vector
    right: Vector
    up: Vector
    half: float
    span: Span = Span.EDGES
    orthographic: bool = False

    def pitch(self, width: int, height: int) -> float:
        """The distance from pixel to pixel, on the plane one unit ahead (orthographic: in the scene)."""
        if self.span is Span.EDGES:
            return 2.0 * self.half / height
        if self.span is Span.NARROW:
            return 2.0 * self.half / min(width, height)
        # One row has no first and last: measure along the row instead; one pixel takes the whole angle.
        rows = height if height > 1 else width
        return 2.0 * self.half / max(rows - 1, 1)

    def table(self, width: int, height: int) -> NDArray[np.void]:
        """The camera for a picture of width x height pixels, CAMERA_RECORD (1,). Pixels are square.

        Raises SceneError if the picture has no pixels.
        """
        if width < 1 or height < 1:
            raise SceneError(f"the picture is {width} x {height} pixels, wanted at least 1 x 1")
        eye, forward, right, up = (np.array(v) for v in (self.eye, self.forward, self.right, self.up))
        pitch = self.pitch(width, height)
        corner = pitch * ((height - 1) / 2.0 * up - (width - 1) / 2.0 * right)
        table = np.zeros(1, CAMERA_RECORD)
        origin, ray = ("base", "eye") if self.orthographic else ("eye", "base")
        table[origin] = forward if self.orthographic else eye
        table[ray] = (eye if self.orthographic else forward) + corner
        table[ray + "_di"] = pitch * right
        table[ray + "_dj"] = -pitch * up
        return table


def nff_camera(eye: ArrayLike, at: ArrayLike, up: ArrayLike, angle: float) -> Camera:
    """The camera of an NFF file: `angle` in degrees spans from the first pixel row's middle to the last one's."""
    return Camera(*_frame(eye, at, up), _half_angle(angle), Span.MIDDLES)


def perspective_camera(eye: ArrayLike, at: ArrayLike, up: ArrayLike, fov: float) -> Camera:
    """A camera at `eye` looking to `at`; `fov` is the vertical angle in degrees from edge to edge.

    `up` need not be perpendicular to the view. Raises SceneError if eye and at coincide, if up is parallel to the
    view, if the angle is not between 0 and 180, or if a number is not finite.
    """
    return Camera(*_frame(eye, at, up), _half_angle(fov), Span.EDGES)


def orthographic_camera(eye: ArrayLike, at: ArrayLike, up: ArrayLike, height: float) -> Camera:
    """A camera with parallel rays; `height` of the view from edge to edge, scene units. Raises as perspective does."""
    if not (math.isfinite(height) and height > 0.0):
        raise SceneError(f"the camera's view is {height:g} high, wanted a finite height above 0")
    return Camera(*_frame(eye, at, up), height / 2.0, Span.EDGES, orthographic=True)


@dataclass(frozen=True)
class NamedCamera:
    """One of the cameras of a scene. `pose` gives it in a frame of the shot; None: it stays."""

    name: str
    camera: Camera
    pose: Callable[[int], Camera] | None = None


# Where a camera stands that sees everything: so much of the front, of the viewer's right as seen from there, and of up.
STANDS = {
    "front": (1.0, 0.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "left": (0.0, -1.0, 0.0),
    "right": (0.0, 1.0, 0.0),
    "top": (0.0, 0.0, 1.0),
    "bottom": (0.0, 0.0, -1.0),
    "three-quarter": (1.0, 0.65, 0.45),
    "iso": (1.0, 1.0, 1.0),
}


def usual_front(up: ArrayLike) -> Vector:
    """The side that is the front unless a scene knows better, perpendicular to what is up: +z if y is up, -y if z is, as
    modelling programs have it."""
    upward = np.asarray(up, np.float64)
    towards = np.array((0.0, -1.0, 0.0)) if _is_vertical(upward) else np.array((0.0, 0.0, 1.0))
    return _level(towards, upward)


def nearest_axis(up: ArrayLike) -> NDArray[np.float64]:
    """The axis of the world, x, y or z to one of its two sides, that is nearest to what is up: a unit vector, (3,)."""
    above = np.asarray(up, np.float64)
    axis = np.zeros(3)
    nearest = int(np.argmax(np.abs(above)))
    axis[nearest] = np.sign(above[nearest])
    return axis


def look_at_everything(bounds: ArrayLike, up: Vector = (0.0, 1.0, 0.0), front: Vector | None = None) -> Camera:
    """A three-quarter view from the front, the right and above that frames the whole box, (2, 3).

    `front`: to that side, None: `usual_front`. Both sides of the picture see the whole box, whatever its aspect.
    """
    return fitted_camera(bounds, up, front, "three-quarter", DEFAULT_FOV)


def fitted_camera(bounds: ArrayLike, up: Vector, front: Vector | None, stand: str, fov: float) -> Camera:
    """A camera that frames the whole box, (2, 3), whatever the picture's aspect, from one of STANDS.

    up, front  of the world; `front` need not be perpendicular, None: `usual_front`
    fov        degrees across the shorter side of the picture; iso has parallel rays, and none
    Raises SceneError as `perspective_camera` does.
    """
    low, high = np.asarray(bounds, np.float64)
    upward = np.asarray(up, np.float64)
    upward = upward / np.abs(upward).max()
    upward = upward / lengths(upward)
    if front is None or abs(dot(np.array(front), upward)) > 0.99:
        front = usual_front(upward)
    ahead = np.array(_level(np.array(front), upward))
    to_front, to_right, to_up = STANDS[stand]
    towards = to_front * ahead + to_right * np.cross(upward, ahead) + to_up * upward
    lifted = upward if to_front or to_right else -to_up * ahead  # from above the back is at the top of the picture
    centre = (low + high) / 2.0
    forward, right, lift = (np.array(v) for v in _frame(centre + towards, centre, lifted)[1:])
    half = _half_angle(fov)
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    offsets = corners - centre
    reach = np.maximum(np.abs(dot(offsets, right)), np.abs(dot(offsets, lift))) * FRAME_MARGIN
    parallel = stand == "iso"
    deep = dot(offsets, forward)
    distance = float(np.max(reach) - deep.min()) if parallel else float(np.max(reach / half - deep))
    # A scene of one point has no size to frame: stay so far away that the eye is another point, rounded too.
    eye = centre - forward * (max(distance, 1e-6 * float(np.abs(centre).max())) or 1.0)
    half = (float(np.max(reach)) or 1.0) if parallel else half
    return Camera(
        _triple(eye), _triple(forward), _triple(right), _triple(lift), half, Span.NARROW, orthographic=parallel
    )


def redirected_camera(
    base: Camera, eye: ArrayLike | None, at: ArrayLike | None, up: ArrayLike | None, fov: float | None
) -> Camera:
    """A camera with another place, aim, up or angle (degrees from the upper edge to the lower); None: that of `base`.

    Raises SceneError as `perspective_camera` does.
    """
    start = np.asarray(base.eye if eye is None else eye, np.float64)
    if at is None:  # so far ahead that rounding does not turn it
        at = start + np.array(base.forward) * max(1.0, float(np.abs(start).max()))
    place, forward, right, lift = _frame(start, at, base.up if up is None else up)
    made = replace(base, eye=place, forward=forward, right=right, up=lift)
    return made if fov is None else replace(made, half=_half_angle(fov), span=Span.EDGES, orthographic=False)


def _is_vertical(up: NDArray[np.float64]) -> bool:
    return bool(abs(up[2]) > 0.5 * np.abs(up).sum())


def _level(towards: NDArray[np.float64], up: NDArray[np.float64]) -> Vector:
    """The direction next to `towards` that is perpendicular to `up`; another axis takes its place if they are parallel."""
    unit = up / lengths(up)
    for direction in (towards, np.array((1.0, 0.0, 0.0))):
        level = direction - dot(direction, unit) * unit
        length = float(lengths(level))
        if length > 1e-3:
            break
    return _triple(level / length)


def _half_angle(angle: float) -> float:
    if not (math.isfinite(angle) and 0.0 < angle < 180.0):
        raise SceneError(f"the camera's angle is {angle:g} degrees, wanted more than 0 and less than 180")
    if angle > WIDEST:
        raise SceneError(
            f"the camera's angle is {angle!r} degrees, wanted at most {WIDEST:g}: wider loses its own axis"
        )
    return rounded.tan(math.radians(angle) / 2.0)


def _frame(eye: ArrayLike, at: ArrayLike, up: ArrayLike) -> tuple[Vector, Vector, Vector, Vector]:
    """Eye, forward, right, up; raises SceneError if they do not span a view."""
    start, aim, above = (np.asarray(v, np.float64) for v in (eye, at, up))
    if not np.isfinite(np.concatenate((start, aim, above))).all():
        raise SceneError("the camera has a number that is not finite in its eye, its aim or its up")
    view = aim - start
    length = float(lengths(view))
    if not length > 1e-12 * float(np.abs(start).max()):
        raise SceneError(f"the camera looks from {_shown(start)} at that same point, wanted two different points")
    forward = view / length
    largest = float(np.abs(above).max())
    if largest > 0.0 and not 1e-100 < largest < 1e100:  # its square may be no number
        above = np.ldexp(above, -math.frexp(largest)[1])
    tall = float(lengths(above))
    sideways = np.cross(forward, above / tall) if tall > 0.0 else np.zeros(3)
    width = float(lengths(sideways))
    if not width > 1e-9:
        raise SceneError(f"the camera's up {_shown(above)} is parallel to its view, wanted another direction")
    right = sideways / width
    return _triple(start), _triple(forward), _triple(right), _triple(np.cross(right, forward))


def _triple(vector: NDArray[np.float64]) -> Vector:
    return float(vector[0]), float(vector[1]), float(vector[2])


def _shown(vector: NDArray[np.float64]) -> str:
    return "({:g}, {:g}, {:g})".format(*vector.tolist())
