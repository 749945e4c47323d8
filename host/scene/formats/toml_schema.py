"""Defines the tables and keys of a scene file (TOML) as pydantic models. `docs/scenes.md` is the reference for users.

Unknown keys are refused: a misspelt one would otherwise be a silent default. Numbers must be numbers ("1.5" is none).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    Strict,
    model_validator,
)

from raygrid.host.scene.builder import LEAST_IOR, MAX_COORDINATE, MOST_IOR

MAX_SIDE = 65_535  # pixels
MAX_DEPTH = 31  # five bits of a packet hold the depth
MAX_FRAME = 1_000_000


def _tripled(value: object) -> object:
    """One number stands for three equal ones."""
    return (value, value, value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise ValueError("Input should be another number than 0")
    return value


def _with_length(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(value):
        raise ValueError("Input should be a direction, not all 0")
    return value


Number = Annotated[float, Strict(), Field(allow_inf_nan=False, ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
NotBelow0 = Annotated[float, Strict(), Field(allow_inf_nan=False, ge=0.0, le=MAX_COORDINATE)]
Above0 = Annotated[float, Strict(), Field(allow_inf_nan=False, gt=0.0, le=MAX_COORDINATE)]
Ior = Annotated[float, Strict(), Field(allow_inf_nan=False, ge=LEAST_IOR, le=MOST_IOR)]
NotZero = Annotated[Number, AfterValidator(_not_zero)]
Whole = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict(), Field(min_length=1)]
Point = tuple[Number, Number, Number]
Direction = Annotated[Point, AfterValidator(_with_length)]
Colour = tuple[NotBelow0, NotBelow0, NotBelow0]
Weight = Annotated[Colour, BeforeValidator(_tripled)]
Scale = Annotated[tuple[NotZero, NotZero, NotZero], BeforeValidator(_tripled)]

WHITE = (1.0, 1.0, 1.0)
COLOUR = Field(default=WHITE, validation_alias=AliasChoices("colour", "color"))


class FileTable(BaseModel):
    """A table of a scene file: no keys but its own."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class Key(FileTable):
    """A table of a list named `keys`: values at a frame."""

    frame: Annotated[Whole, Field(ge=1, le=MAX_FRAME)]


def _ascending(keys: list[Key]) -> list[Key]:
    for number, (one, other) in enumerate(pairwise(keys), 1):
        if other.frame <= one.frame:
            raise ValueError(
                f"Input should be keys in ascending order of frames, key {number} is at {other.frame} after {one.frame}"
            )
    return keys


Way = Literal["linear", "smooth"]


class Image(FileTable):
    """[image]"""

    width: Annotated[Whole, Field(ge=1, le=MAX_SIDE)] | None = None
    height: Annotated[Whole, Field(ge=1, le=MAX_SIDE)] | None = None
    samples: Annotated[Whole, Field(ge=1, le=MAX_SIDE)] | None = None
    depth: Annotated[Whole, Field(ge=1, le=MAX_DEPTH)] | None = None
    min_weight: NotBelow0 | None = None

    @model_validator(mode="after")
    def _both_sides(self) -> Image:
        if (self.width is None) != (self.height is None):
            raise ValueError("Input should be both width and height, or neither")
        return self


class AnimationTable(FileTable):
    """[shot]"""

    frames: Annotated[Whole, Field(ge=1, le=MAX_FRAME)] | None = None
    fps: Annotated[float, Strict(), Field(gt=0.0, le=1000.0)] = 24.0
    interpolation: Way = "linear"


class Motion(FileTable):
    """What the keys of a group change."""

    translate: Point = (0.0, 0.0, 0.0)
    rotate: Point = (0.0, 0.0, 0.0)
    scale: Above0 = 1.0


class GroupKey(Key):
    """[[groups.NAME.keys]]"""

    translate: Point | None = None
    rotate: Point | None = None
    scale: Above0 | None = None


class Group(FileTable):
    """[groups.NAME]"""

    parent: Text | None = None
    pivot: Point = (0.0, 0.0, 0.0)
    interpolation: Way | None = None
    keys: Annotated[list[GroupKey], AfterValidator(_ascending)] = Field(default_factory=list)


class CameraKey(Key):
    """[[camera.keys]]"""

    eye: Point | None = Field(default=None, validation_alias=AliasChoices("from", "eye"))
    at: Point | None = None
    up: Direction | None = None
    fov: Annotated[float, Strict(), Field(gt=0.0, lt=180.0)] | None = None
    orthographic: Above0 | None = None


class CameraTable(FileTable):
    """[camera]"""

    eye: Point = Field(validation_alias=AliasChoices("from", "eye"))
    at: Point
    up: Direction = (0.0, 1.0, 0.0)
    fov: Annotated[float, Strict(), Field(gt=0.0, lt=180.0)] | None = None
    orthographic: Above0 | None = None
    keys: Annotated[list[CameraKey], AfterValidator(_ascending)] = Field(default_factory=list)

    @model_validator(mode="after")
    def _one_view(self) -> CameraTable:
        named = {
            name for table in (self, *self.keys) for name in ("fov", "orthographic") if getattr(table, name) is not None
        }
        if len(named) == 2:
            raise ValueError("Input should be either fov or orthographic, not both")
        return self


class MaterialKey(Key):
    """[[materials.NAME.keys]]"""

    colour: Colour | None = Field(default=None, validation_alias=AliasChoices("colour", "color"))
    diffuse: Weight | None = None
    highlight: Weight | None = None
    shine: NotBelow0 | None = None
    specular: Weight | None = None
    transmission: Weight | None = None
    ior: Ior | None = None


class Material(FileTable):
    """[materials.NAME]"""

    colour: Colour = COLOUR
    diffuse: Weight = WHITE
    highlight: Weight = (0.0, 0.0, 0.0)
    shine: NotBelow0 = 50.0
    specular: Weight = (0.0, 0.0, 0.0)
    transmission: Weight = (0.0, 0.0, 0.0)
    ior: Ior = 1.5
    rule: Annotated[list[Number], Field(max_length=8)] | None = None
    keys: Annotated[list[MaterialKey], AfterValidator(_ascending)] = Field(default_factory=list)


class LightKey(Key):
    """[[lights.keys]]"""

    intensity: NotBelow0 | None = None
    colour: Colour | None = Field(default=None, validation_alias=AliasChoices("colour", "color"))


class PointKey(LightKey):
    """[[lights.keys]] of a point light"""

    position: Point | None = None


class SpotKey(PointKey):
    """[[lights.keys]] of a spot light"""

    at: Point | None = None


class DirectionalKey(LightKey):
    """[[lights.keys]] of a directional light"""

    towards: Direction | None = None


class PointLight(FileTable):
    """[[lights]] of kind point"""

    kind: Literal["point"]
    keys: Annotated[list[PointKey], AfterValidator(_ascending)] = Field(default_factory=list)
    position: Point
    intensity: NotBelow0 = 1.0
    colour: Colour = COLOUR
    falloff: Flag = False


class SpotLight(FileTable):
    """[[lights]] of kind spot; the angles are measured from the axis."""

    kind: Literal["spot"]
    keys: Annotated[list[SpotKey], AfterValidator(_ascending)] = Field(default_factory=list)
    position: Point
    at: Point
    intensity: NotBelow0 = 1.0
    colour: Colour = COLOUR
    falloff: Flag = False
    outer_degrees: Annotated[float, Strict(), Field(gt=0.0, le=180.0)] = 30.0
    inner_degrees: Annotated[float, Strict(), Field(ge=0.0, le=180.0)] | None = None

    @model_validator(mode="after")
    def _sound(self) -> SpotLight:
        if self.inner_degrees is not None and self.inner_degrees > self.outer_degrees:
            raise ValueError("Input should be inner_degrees of at most outer_degrees")
        if self.position == self.at:
            raise ValueError("Input should be two different points as position and at")
        return self


class DirectionalLight(FileTable):
    """[[lights]] of kind directional"""

    kind: Literal["directional"]
    keys: Annotated[list[DirectionalKey], AfterValidator(_ascending)] = Field(default_factory=list)
    towards: Direction
    intensity: NotBelow0 = 1.0
    colour: Colour = COLOUR
    disc_degrees: Annotated[float, Strict(), Field(ge=0.0, le=90.0)] | None = None
    disc_colour: Colour | None = Field(default=None, validation_alias=AliasChoices("disc_colour", "disc_color"))


class SurfaceTable(FileTable):
    """[[surfaces]] of any kind"""

    kind: str
    material: Text | None = None
    group: Text | None = None


class Sphere(SurfaceTable):
    """[[surfaces]] of kind sphere; below 0 the radius means that only the inside shows."""

    kind: Literal["sphere"]
    centre: Point = Field(validation_alias=AliasChoices("centre", "center"))
    radius: NotZero


class Cylinder(SurfaceTable):
    """[[surfaces]] of kind cylinder, open at both ends"""

    kind: Literal["cylinder"]
    base: Point
    top: Point
    radius: NotZero


class Cone(SurfaceTable):
    """[[surfaces]] of kind cone, open at both ends"""

    kind: Literal["cone"]
    base: Point
    base_radius: Number
    apex: Point
    apex_radius: Number = 0.0


class Triangle(SurfaceTable):
    """[[surfaces]] of kind triangle"""

    kind: Literal["triangle"]
    points: tuple[Point, Point, Point]
    normals: tuple[Direction, Direction, Direction] | None = None


class Polygon(SurfaceTable):
    """[[surfaces]] of kind polygon"""

    kind: Literal["polygon"]
    points: Annotated[list[Point], Field(min_length=3)]


class Box(SurfaceTable):
    """[[surfaces]] of kind box, along the axes"""

    kind: Literal["box"]
    low: Point
    high: Point

    @model_validator(mode="after")
    def _has_volume(self) -> Box:
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError("Input should be a box whose low is below its high along all axes")
        return self


class ProgramSurface(SurfaceTable):
    """[[surfaces]] of kind program: what the program makes of its numbers, in a box"""

    kind: Literal["program"]
    centre: Point = Field(validation_alias=AliasChoices("centre", "center"))
    half: tuple[Above0, Above0, Above0]
    scale: Above0 = 1.0
    rotate: Point = (0.0, 0.0, 0.0)
    numbers: Annotated[list[Number], Field(max_length=8)] = Field(default_factory=list)


class Mesh(FileTable):
    """[[meshes]]: the surfaces of another file"""

    file: Text
    material: Text | None = None
    group: Text | None = None
    scale: Scale = WHITE
    rotate: Point = (0.0, 0.0, 0.0)
    translate: Point = (0.0, 0.0, 0.0)
    crease: Annotated[float, Strict(), Field(ge=0.0, le=180.0)] | None = None


Light = Annotated[PointLight | SpotLight | DirectionalLight, Field(discriminator="kind")]
Surface = Annotated[Sphere | Cylinder | Cone | Triangle | Polygon | Box | ProgramSurface, Field(discriminator="kind")]


class SceneFile(FileTable):
    """The whole file."""

    include: Text | None = None
    background: Colour | None = None
    highlights: Flag | None = None
    image: Image | None = None
    camera: CameraTable | None = None
    shot: AnimationTable | None = None
    groups: dict[str, Group] = Field(default_factory=dict)
    materials: dict[str, Material] = Field(default_factory=dict)
    lights: list[Light] = Field(default_factory=list)
    surfaces: list[Surface] = Field(default_factory=list)
    meshes: list[Mesh] = Field(default_factory=list)


TABLES: dict[str, type[FileTable]] = {
    "image": Image,
    "shot": AnimationTable,
    "groups": Group,
    "camera": CameraTable,
    "materials": Material,
    "meshes": Mesh,
    "point": PointLight,
    "spot": SpotLight,
    "directional": DirectionalLight,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "cone": Cone,
    "triangle": Triangle,
    "polygon": Polygon,
    "box": Box,
    "program": ProgramSurface,
}
"""The model of each table, by its name or its kind: for telling which keys it has."""

KEYS: dict[str, type[Key]] = {
    "groups": GroupKey,
    "camera": CameraKey,
    "materials": MaterialKey,
    "point": PointKey,
    "spot": SpotKey,
    "directional": DirectionalKey,
}
"""The model of a table's list of keys, likewise."""
