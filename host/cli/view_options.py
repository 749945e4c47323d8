"""Declares the options that say from where and in which light a scene is seen, for all commands that render one."""

from __future__ import annotations

import click

from raygrid.host.cli.types import AnyType, Command, NumberType, read_number, shorten
from raygrid.host.scene.view import CAMERA, FITS, LONGEST_NAME, MAX_NUMBER, MOST_CREASE, WIDEST

Numbers = tuple[float, ...]


class NumbersType(AnyType):
    """Numbers between commas, `0,2,8`: as many as one of `counts` says, those from `bounded` on 0 or more."""

    name = "numbers"

    def __init__(self, counts: tuple[int, ...], wanted: str, bounded: int = 99) -> None:
        self._counts, self._wanted, self._bounded = counts, wanted, bounded

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Numbers:
        """Raises a usage error for anything else, NaN too."""
        if isinstance(value, tuple):
            return value
        words = [word.strip() for word in str(value).split(",")]
        row = tuple(map(read_number, words))
        sound = all(abs(number) <= MAX_NUMBER for number in row) and all(
            number >= 0.0 for number in row[self._bounded :]
        )
        if len(row) not in self._counts or not sound:
            self.fail(f"{shorten(value)} came, wanted {self._wanted}", param, ctx)
        return row


class CameraName(AnyType):
    """The name of a camera, or its number."""

    name = "camera"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Raises a usage error for what no camera can be called."""
        if not 0 < len(str(value)) <= LONGEST_NAME:
            self.fail(f"{shorten(value)} came, wanted {CAMERA}", param, ctx)
        return str(value)


def _angle(ctx: click.Context, param: click.Parameter, value: float | None) -> float | None:
    if value == 0.0:
        raise click.BadParameter(f"0 came, wanted an angle above 0 and at most {WIDEST:g}", ctx, param)
    return value


def _some(_ctx: click.Context, _param: click.Parameter, values: tuple[Numbers, ...]) -> tuple[Numbers, ...] | None:
    """None if the option did not come: then the scene's own lights shine."""
    return values or None


POINT = NumbersType((3,), "three finite numbers such as 0,2,8")
COLOUR = NumbersType((3,), "three finite numbers of 0 or more such as 0.2,0.2,0.25", bounded=0)
LIGHT = NumbersType(
    (3, 6), "three finite numbers such as 5,8,5, or six with a colour such as 5,8,5,1,0.9,0.8", bounded=3
)


def view_options(command: Command) -> Command:
    """--from, --at, --up, --fov, --camera, --fit, --light, --background and --crease (`raygrid.host.scene.view.GivenView`)."""
    options = (
        click.option("--from", "eye", type=POINT, metavar="X,Y,Z",
                     help="Where the camera stands. It looks at --at, else at the middle of the scene."),
        click.option("--at", type=POINT, metavar="X,Y,Z", help="What the camera looks at."),
        click.option("--up", type=POINT, metavar="X,Y,Z", help="What is up.  [default: as the scene or its format has it]"),
        click.option("--fov", type=NumberType(0.0, WIDEST), callback=_angle, metavar="DEG",
                     help="The camera's vertical angle, in degrees."),
        click.option("--camera", type=CameraName(), metavar="NAME|N", help="One of the scene's cameras, by name or number from 1."),
        click.option("--fit", type=click.Choice(FITS), help="See all of the scene from there. iso has parallel rays."),
        click.option("--light", "lights", type=LIGHT, multiple=True, callback=_some, metavar="X,Y,Z[,R,G,B]",
                     help="A point light, instead of the scene's; linear colour, white if none. May be repeated."),
        click.option("--background", type=COLOUR, metavar="R,G,B", help="What rays see that leave the scene; linear."),
        click.option("--crease", type=NumberType(0.0, MOST_CREASE), metavar="DEG",
                     help="Meshes without normals are smooth across edges that bend by no more; 0: facets.  "
                          "[default: 40, glTF 0]"),
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command
