"""Checks from where and in which light a scene is to be seen, whatever it asks for itself. Light to import.

`viewpoint.seen` applies it to a scene. In Python the keywords are those of `GivenView`, on the command line the options
of `host.cli.view_options`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn, TypedDict, cast

from raygrid.host.text.clean_text import shown
from raygrid.host.text.misuse import SceneMisuse

Triple = tuple[float, float, float]

FITS = ("front", "back", "left", "right", "top", "bottom", "three-quarter", "iso")
MAX_NUMBER = 1e30
WIDEST = 179.99  # degrees, as of all cameras
MOST_CREASE = 180.0  # degrees
LONGEST_NAME = 1000  # characters
MOST_LIGHTS = 256  # more are asked of a file

THREE = "three finite numbers of at most 1e30 in size such as 0, 2, 8"
COLOUR = "three finite numbers of 0 or more such as 0.2, 0.2, 0.25, linear red, green and blue"
LIGHT = "a position x, y, z, or with a colour x, y, z, r, g, b, of finite numbers, no colour below 0"
ANGLE = f"an angle above 0 and at most {WIDEST:g} degrees"
CREASE = f"an angle from 0 to {MOST_CREASE:g} degrees"
CAMERA = "the name of a camera, or its number from 1"


class GivenView(TypedDict, total=False):
    """From where and in which light, by keyword; left out or None: as the scene has it.

    eye         where the camera stands, scene coordinates
    at          what it looks at; with an eye alone the middle of the scene's box
    up          what points up in the picture, and in the world for `fit`
    fov         vertical angle in degrees, from the upper edge of the picture to the lower
    camera      one of the scene's own: its name, or its number from 1
    fit         "front", "back", "left", "right", "top", "bottom", "three-quarter" or "iso": from there all is seen
    lights      point lights instead of the scene's: (x, y, z) each, or (x, y, z, r, g, b), linear, without falloff
    background  linear red, green and blue that rays see which leave the scene
    crease      degrees: meshes without normals are smooth across edges that bend by no more; 0: facets
    """

    eye: Sequence[float] | None
    at: Sequence[float] | None
    up: Sequence[float] | None
    fov: float | None
    camera: str | int | None
    fit: str | None
    lights: Sequence[Sequence[float]] | None
    background: Sequence[float] | None
    crease: float | None


VIEW = tuple(GivenView.__annotations__)


@dataclass(frozen=True)
class View:
    """Holds a `GivenView` as it was checked; None and no lights: as the scene has it."""

    eye: Triple | None = None
    at: Triple | None = None
    up: Triple | None = None
    fov: float | None = None
    camera: str | int | None = None
    fit: str | None = None
    lights: tuple[tuple[float, ...], ...] = ()
    background: Triple | None = None
    crease: float | None = None

    @property
    def moves_camera(self) -> bool:
        """Whether the camera is not to be the scene's own as it is."""
        return any(value is not None for value in (self.eye, self.at, self.up, self.fov, self.camera, self.fit))

    def given(self) -> GivenView:
        """The keywords by which it is asked for."""
        return cast(
            GivenView, {name: getattr(self, name) for name in VIEW if getattr(self, name) != getattr(View, name)}
        )


def view_of(given: GivenView) -> View:
    """The view of keywords. Raises SceneMisuse for the first that cannot be, alone or with another."""
    lights = given.get("lights")
    view = View(
        _triple("eye", given.get("eye")),
        _triple("at", given.get("at")),
        _triple("up", given.get("up")),
        _angle("fov", given.get("fov"), 0.0, WIDEST, ANGLE),
        _camera(given.get("camera")),
        _fit(given.get("fit")),
        () if lights is None else _lights(lights),
        _colour(given.get("background")),
        _angle("crease", given.get("crease"), None, MOST_CREASE, CREASE),
    )
    for one, other in (("fit", "eye"), ("fit", "at"), ("camera", "fit"), ("camera", "eye")):
        if getattr(view, one) is not None and getattr(view, other) is not None:
            raise SceneMisuse(f"{SPOKEN[one]} and {SPOKEN[other]} came, wanted one of them")
    return view


SPOKEN = {
    "eye": "--from (in Python eye=)",
    "at": "--at (at=)",
    "fit": "--fit (in Python fit=)",
    "camera": "--camera (camera=)",
}


def numbers(value: Any) -> list[float] | None:
    """A row of numbers, numpy's too, as finite floats of at most 1e30 in size; None for anything else."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        return None
    row = [_number(item) for item in value]
    return None if any(item is None for item in row) else cast(list[float], row)


def _number(value: Any) -> float | None:
    if getattr(value, "ndim", None) == 0 and not isinstance(value, int | float):
        value = value.item()  # a number of numpy
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= MAX_NUMBER:
        return None
    return float(value)


def _triple(name: str, value: Any) -> Triple | None:
    if value is None:
        return None
    row = numbers(value)
    if row is None or len(row) != 3:
        _refuse(name, value, THREE)
    if name == "up" and not any(row):
        _refuse(name, value, "a direction, not all 0")
    return row[0], row[1], row[2]


def _colour(value: Any) -> Triple | None:
    if value is None:
        return None
    row = numbers(value)
    if row is None or len(row) != 3 or min(row) < 0.0:
        _refuse("background", value, COLOUR)
    return row[0], row[1], row[2]


def _lights(value: Any) -> tuple[tuple[float, ...], ...]:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, str | bytes) or not isinstance(value, Sequence) or len(value) > MOST_LIGHTS:
        _refuse("lights", value, f"a list of at most {MOST_LIGHTS}, each {LIGHT}")
    rows = []
    for item in value:
        row = numbers(item)
        if row is None or len(row) not in (3, 6) or min(row[3:], default=0.0) < 0.0:
            _refuse("a light", item, LIGHT)
        rows.append(tuple(row))
    return tuple(rows)


def _angle(name: str, value: Any, above: float | None, most: float, wanted: str) -> float | None:
    if value is None:
        return None
    angle = _number(value)
    if angle is None or not 0.0 <= angle <= most or angle == above:
        _refuse(name, value, wanted)
    return angle


def _camera(value: Any) -> str | int | None:
    if value is None or (isinstance(value, str) and 0 < len(value) <= LONGEST_NAME):
        return value
    if isinstance(value, bool) or not isinstance(value, int):
        _refuse("camera", value, CAMERA)
    return value


def _fit(value: Any) -> str | None:
    if value is None:
        return None
    if not isinstance(value, str) or value not in FITS:
        _refuse("fit", value, f"one of: {', '.join(FITS)}")
    return str(value)


def _refuse(name: str, value: Any, wanted: str) -> NoReturn:
    raise SceneMisuse(f"{name} came as {shown(value)}, wanted {wanted}")
