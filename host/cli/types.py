"""Checks what options are given: their types, and the options that several commands have."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from raygrid.host.image.layer_names import LAYERS, checked_layers
from raygrid.host.text.bounds import MAX_PIXELS, MAX_SIDE

if TYPE_CHECKING:
    from raygrid.node.links import FaultPlan

    AnyType = click.ParamType[Any]
else:
    AnyType = click.ParamType  # not generic before click 8.4

Command = Callable[..., object]

COST_MODELS = ("8086", "8086-soft", "t800", "unit", "modern")
SIZES = f"wanted sides of 1 to {MAX_SIDE} and at most {MAX_PIXELS:,} pixels"


class PairType(AnyType):
    """Two whole numbers, `512x384`."""

    name = "pair"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Raises a usage error for anything else."""
        numbers = str(value).lower().split("x")
        if len(numbers) != 2 or not all(number.isascii() and number.isdigit() for number in numbers):
            self.fail(f"{shorten(value)} came, wanted two whole numbers such as 512x384", param, ctx)
        if any(len(number) > 9 or int(number) < 1 for number in numbers):
            self.fail(f"{shorten(value)} came, {SIZES}", param, ctx)
        width, height = int(numbers[0]), int(numbers[1])
        if max(width, height) > MAX_SIDE or width * height > MAX_PIXELS:
            self.fail(f"{shorten(value)} came, {SIZES}", param, ctx)
        return width, height


class FileName(AnyType):
    """The name of a file or folder, there or not."""

    name = "file"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Raises a usage error for what no file can be called."""
        if not value or "\0" in str(value):
            self.fail(f"{shorten(value)} came, wanted the name of a file", param, ctx)
        return str(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """What the shell finds."""
        return [CompletionItem(incomplete, type="file")]


class SceneName(AnyType):
    """The name of a scene, checked where it is read."""

    name = "scene"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """What the shell finds."""
        return [CompletionItem(incomplete, type="file")]


class CostName(AnyType):
    """The name of a cost model that is built in, or of a file, checked where it is read."""

    name = "cost"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Those that are built in, else what the shell finds."""
        named = [name for name in COST_MODELS if name.startswith(incomplete)]
        return [CompletionItem(incomplete, type="file"), *map(CompletionItem, named)]


class ShapeType(AnyType):
    """An array, `2x2x2`."""

    name = "shape"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int, int]:
        """Raises a usage error for anything but three whole numbers of 1 or more."""
        from raygrid.emulator.topology import parse_shape

        if isinstance(value, tuple):
            return value
        try:
            return parse_shape(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


class EdgesType(AnyType):
    """Edges of arrays, `1,2,4,8`."""

    name = "edges"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        """Raises a usage error for anything but whole numbers of 1 to 1024 between commas."""
        if isinstance(value, tuple):
            return value
        words = [word.strip() for word in str(value).split(",")]
        if not all(word.isascii() and word.isdigit() and len(word) < 5 and 1 <= int(word) <= 1024 for word in words):
            self.fail(f"{shorten(value)} came, wanted edges of 1 to 1024 such as 1,2,4,8", param, ctx)
        return tuple(sorted({int(word) for word in words}))


class FramesType(AnyType):
    """Frames of a shot, `1-48` or `7`: the first and the last."""

    name = "frames"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Raises a usage error for anything else."""
        if isinstance(value, tuple):
            return value
        from raygrid.host.image.frames import parse_frames

        try:
            return parse_frames(str(value))
        except ValueError as error:
            self.fail(f"{shorten(value)} came, {error}", param, ctx)


class LayersType(AnyType):
    """Layers of a picture, `depth,normal`."""

    name = "layers"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Raises a usage error for names that are none."""
        if isinstance(value, tuple):
            return value
        from raygrid.host.text.misuse import SceneMisuse

        try:
            return checked_layers([word.strip() for word in str(value).split(",")])
        except SceneMisuse as error:
            self.fail(str(error), param, ctx)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Each layer that is not named yet, after those that are."""
        *before, last = incomplete.split(",")
        return [
            CompletionItem(",".join([*before, layer]))
            for layer in LAYERS
            if layer not in before and layer.startswith(last)
        ]


class FaultType(AnyType):
    """A fault for experiments, `drop:0.001:7`."""

    name = "fault"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> FaultPlan:
        """Raises a usage error for anything that `parse_fault` refuses."""
        from raygrid.node.links import parse_fault

        try:
            return parse_fault(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


def read_number(word: str, read: Callable[[str], float] = float) -> float:
    """The number that a word says; NaN for what is none, is longer than any number need be, or has what Python alone allows."""
    try:
        return read(word) if len(word) < 40 and word.isascii() and not set(word) & set("_ ") else math.nan
    except ValueError:
        return math.nan


class NumberType(AnyType):
    """A number from `least` to `most`; whole if `least` is."""

    name = "number"

    def __init__(self, least: float, most: float) -> None:
        self._least, self._most = least, most

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Raises a usage error for anything else, NaN too."""
        whole = isinstance(self._least, int)
        number = read_number(str(value), int if whole else float)
        if not self._least <= number <= self._most:
            kind = "whole number" if whole else "number"
            self.fail(f"{shorten(value)} came, wanted a {kind} from {self._least} to {self._most}", param, ctx)
        return number


def once(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> str | None:
    """The one value of an option that click takes as often as it comes: of two files one would not be written."""
    if len(values) > 1:
        raise click.BadParameter("came more than once, wanted it once", ctx, param)
    return values[0] if values else None


def path_option(*names: str, **about: Any) -> Callable[[Command], Command]:
    """An option for the name of one file or folder that is written."""
    return click.option(*names, type=FileName(), multiple=True, callback=once, **about)


def shorten(value: object) -> str:
    text = str(value)
    return repr(text if len(text) <= 40 else text[:37] + "...")


def debug_option(command: Command) -> Command:
    """--debug, understood before and after the command's name; `main` looks for it before anything else."""
    return click.option("--debug", is_flag=True, expose_value=False, help="Show the tracebacks of errors.")(command)


def outside_option(command: Command) -> Command:
    """--allow-outside, of every command that reads a scene: it holds for all that the command reads."""

    def allow(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
        from raygrid.host.scene.load import outside_allowed

        if value:
            ctx.with_resource(outside_allowed())

    text = "Let the scene refer to files outside its folder. They are read with your rights."
    return click.option("--allow-outside", is_flag=True, expose_value=False, callback=allow, help=text)(command)
