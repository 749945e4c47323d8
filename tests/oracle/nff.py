"""A reader of Neutral File Format scenes, token by token."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .scene import OracleScene, SceneBuilder, nff_camera

VIEW_WORDS = {"from": 3, "at": 3, "up": 3, "angle": 1, "hither": 1, "resolution": 2}


class NffError(ValueError):
    """The text is not NFF; says where."""


class Tokens:
    """The file's words without comments, each with its line; reading one moves on."""

    def __init__(self, text: str, name: str) -> None:
        self._name = name
        self._words = list(_words(text))
        self._next = 0

    def more(self) -> bool:
        return self._next < len(self._words)

    def word(self) -> str:
        if not self.more():
            raise NffError(f"{self._name}: ends in the middle of an entity")
        self._next += 1
        return self._words[self._next - 1][1]

    def next_is_number(self) -> bool:
        return self.more() and _number(self._words[self._next][1]) is not None

    def number(self) -> float:
        value = _number(self.word())
        if value is None:
            raise self.error("a number is wanted")
        return value

    def numbers(self, count: int) -> list[float]:
        return [self.number() for _ in range(count)]

    def integer(self) -> int:
        value = self.number()
        if value != int(value):
            raise self.error("a whole number is wanted")
        return int(value)

    def error(self, wanted: str) -> NffError:
        """About the word read last."""
        line, word = self._words[self._next - 1]
        return NffError(f"{self._name}:{line}: {wanted}, not {word!r}")


def _words(text: str) -> Iterator[tuple[int, str]]:
    for line, content in enumerate(text.splitlines(), start=1):
        for word in content.partition("#")[0].split():
            yield line, word


def _number(word: str) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def read_nff(
    path: str | Path, width: int | None = None, height: int | None = None, *, highlights: bool = False
) -> OracleScene:
    """The scene in a file, its camera for a picture of width x height (if None, the file's own resolution)."""
    return parse_nff(Path(path).read_text(encoding="ascii"), width, height, highlights=highlights, name=str(path))


def parse_nff(
    text: str, width: int | None = None, height: int | None = None, *, highlights: bool = False, name: str = "nff"
) -> OracleScene:
    tokens = Tokens(text, name)
    reader = _Reader(tokens, highlights)
    while tokens.more():
        reader.entity(tokens.word())
    return reader.scene(name, width, height)


class _Reader:
    """What has been read so far."""

    def __init__(self, tokens: Tokens, highlights: bool) -> None:
        self._tokens = tokens
        self._highlights = highlights
        self._builder = SceneBuilder()
        self._material = -1
        self._background = [0.0, 0.0, 0.0]
        self._view: dict[str, list[float]] = {}
        self._lights: list[tuple[list[float], list[float]]] = []  # position, colour

    def entity(self, word: str) -> None:
        entities = {
            "v": self._read_view,
            "b": self._read_background,
            "l": self._read_light,
            "f": self._read_fill,
            "s": self._read_sphere,
            "c": self._read_cone,
            "p": self._read_polygon,
            "pp": self._read_patch,
        }
        if word not in entities:
            raise self._tokens.error("one of v b l f s c p pp is wanted")
        if word in ("s", "c", "p", "pp") and self._material < 0:
            raise self._tokens.error("an f before the first surface is wanted")
        entities[word]()

    def scene(self, name: str, width: int | None, height: int | None) -> OracleScene:
        if not self._view:
            raise NffError(f"{name}: has no v")
        if width is None or height is None:
            width, height = (int(n) for n in self._view["resolution"])
        for position, colour in self._lights:
            self._builder.point_light(position, np.array(colour) / math.sqrt(len(self._lights)))
        view = self._view
        camera = nff_camera(view["from"], view["at"], view["up"], view["angle"][0], width, height)
        return self._builder.build(camera, self._background)

    def _read_view(self) -> None:
        for _ in VIEW_WORDS:
            word = self._tokens.word()
            if word not in VIEW_WORDS or word in self._view:
                raise self._tokens.error("each of from at up angle hither resolution is wanted once after v")
            self._view[word] = self._tokens.numbers(VIEW_WORDS[word])

    def _read_background(self) -> None:
        self._background = self._tokens.numbers(3)

    def _read_light(self) -> None:
        position = self._tokens.numbers(3)
        colour = self._tokens.numbers(3) if self._tokens.next_is_number() else [1.0, 1.0, 1.0]
        self._lights.append((position, colour))

    def _read_fill(self) -> None:
        colour = np.array(self._tokens.numbers(3))
        kd, ks, shine, t, ior = self._tokens.numbers(5)
        self._material = self._builder.material(
            diffuse=kd * colour,
            specular=ks,
            shine=shine,
            transmission=t,
            ior=ior,
            highlight=ks if self._highlights else 0.0,
        )

    def _read_sphere(self) -> None:
        *centre, radius = self._tokens.numbers(4)
        self._builder.sphere(centre, radius, self._material)

    def _read_cone(self) -> None:
        numbers = self._tokens.numbers(8)
        self._builder.cone(numbers[0:3], numbers[3], numbers[4:7], numbers[7], self._material)

    def _read_polygon(self) -> None:
        """Of three points a triangle: the same surface, and a point's three weights are the simpler test."""
        count = self._tokens.integer()
        vertices = [self._tokens.numbers(3) for _ in range(count)]
        if count == 3:
            self._builder.triangle(vertices, self._material)
        else:
            self._builder.polygon(vertices, self._material)

    def _read_patch(self) -> None:
        if self._tokens.integer() != 3:
            raise self._tokens.error("a pp of 3 points is wanted (how to weight more normals is not said)")
        rows = [self._tokens.numbers(6) for _ in range(3)]
        self._builder.smooth_triangle([row[:3] for row in rows], [row[3:] for row in rows], self._material)
