"""What the command line's options take."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    AnyType = click.ParamType[Any]
else:
    AnyType = click.ParamType  # not generic before click 8.4


class Pair(AnyType):
    """Two whole numbers, `512x384`."""

    name = "pair"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Raises a usage error for anything else."""
        numbers = str(value).lower().split("x")
        if len(numbers) != 2 or not all(number.isascii() and number.isdigit() for number in numbers):
            self.fail(f"{shorten(value)} came, wanted two whole numbers such as 512x384", param, ctx)
        if any(len(number) > 9 or int(number) < 1 for number in numbers):
            self.fail(f"{shorten(value)} came, wanted sides of 1 to 65536", param, ctx)
        return int(numbers[0]), int(numbers[1])


class Place(AnyType):
    """A pixel, `200,150`."""

    name = "place"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Raises a usage error for anything else."""
        numbers = str(value).split(",")
        if len(numbers) != 2 or not all(
            number.isascii() and number.isdigit() and len(number) < 10 for number in numbers
        ):
            self.fail(f"{shorten(value)} came, wanted column and row such as 200,150", param, ctx)
        return int(numbers[0]), int(numbers[1])


class Shape(AnyType):
    """An array, `2x2x2`."""

    name = "shape"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int, int]:
        """Raises a usage error for anything but three whole numbers of 1 or more."""
        from raygrid.emulator.limits import parse_shape

        if isinstance(value, tuple):
            return value
        try:
            return parse_shape(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Fault(AnyType):
    """A fault for experiments, `drop:0.001:7`."""

    name = "fault"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Raises a usage error for anything that `parse_fault` refuses."""
        from raygrid.node.faulty import parse_fault

        try:
            return parse_fault(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Number(AnyType):
    """A number from `least` to `most`; whole if `least` is."""

    name = "number"

    def __init__(self, least: float, most: float) -> None:
        self._least, self._most = least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Raises a usage error for anything else, NaN too."""
        whole = isinstance(self._least, int)
        read: Callable[[str], float] = int if whole else float
        try:
            number = read(value) if len(str(value)) < 40 else math.nan
        except ValueError:
            number = math.nan
        if not self._least <= number <= self._most:
            kind = "whole number" if whole else "number"
            self.fail(f"{shorten(value)} came, wanted a {kind} from {self._least} to {self._most}", param, ctx)
        return number


def shorten(value: Any) -> str:
    """A value as an error quotes it."""
    text = str(value)
    return repr(text if len(text) <= 40 else text[:37] + "...")


class ArrayName(AnyType):
    """The name of an array that stays."""

    name = "name"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Raises a usage error for what cannot be one."""
        from raygrid.host.service_files import check_array_name
        from raygrid.node.errors import ArrayError

        try:
            check_array_name(str(value))
        except ArrayError as error:
            self.fail(str(error), param, ctx)
        return str(value)


class Frames(AnyType):
    """Frames, `1-250` or `7`: the first and the last."""

    name = "frames"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Raises a usage error for anything else."""
        from raygrid.host.frames import parse_frames

        if isinstance(value, tuple):
            return value
        try:
            return parse_frames(str(value))
        except ValueError as error:
            self.fail(f"{shorten(value)} came, {error}", param, ctx)
