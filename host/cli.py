"""The command line. Heavy libraries are imported by the commands that need them, so that --help is quick.

Exit codes: 0 done, 1 failed, 2 usage. Results go to standard output, talk to standard error.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import traceback
from collections.abc import Iterator
from typing import Any

import click

EXAMPLES = """\b
Examples:
  raygrid render scenes/room.glb
  raygrid render scenes/glass.toml --array 3x3x3 --size 800x600 --samples 4 -o glass.png
  raygrid render balls.nff --split uniform -o balls.npy --stats balls.json
  raygrid info scenes/room.glb
"""


class Pair(click.ParamType[Any]):
    """Two whole numbers, `512x384`."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Raises a usage error for anything else."""
        numbers = str(value).lower().split("x")
        if len(numbers) != 2 or not all(number.isascii() and number.isdigit() for number in numbers):
            self.fail(f"came as {value!r}, wanted two whole numbers such as 512x512", param, ctx)
        width, height = int(numbers[0]), int(numbers[1])
        if width < 1 or height < 1:
            self.fail(f"came as {value!r}, wanted sides of 1 or more", param, ctx)
        return width, height


class Shape(click.ParamType[Any]):
    """An array, `2x2x2`."""

    name = "NXxNYxNZ"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int, int]:
        """Raises a usage error for anything but three whole numbers of 1 or more."""
        from raygrid.emulator.limits import parse_shape

        if isinstance(value, tuple):
            return value
        try:
            return parse_shape(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


@click.group(epilog=EXAMPLES, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="raygrid")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.pass_context
def cli(context: click.Context, debug: bool) -> None:
    """The parallel ray tracing computer of 1983: processors that each own a box of space and talk to their neighbours."""
    context.obj = debug


@cli.command(epilog=EXAMPLES)
@click.argument("scene", type=click.Path())
@click.option("--array", "shape", type=Shape(), default="2x2x2", show_default=True, help="Processors on each axis.")
@click.option("--size", type=Pair(), help="Pixels. [default: what the scene asks for, else 512x512]")
@click.option("--samples", type=click.IntRange(min=1), help="Samples a pixel. [default: the scene's, else 1]")
@click.option("--depth", type=click.IntRange(1, 31), help="Depth of the last hit that is lit. [default: the scene's, else 5]")
@click.option("--min-weight", type=click.FloatRange(min=0.0), help="Rays fainter than this are not born. [default: the scene's, else 0]")
@click.option("--highlights/--no-highlights", default=None, help="Phong highlights. [default: off for NFF, else on]")
@click.option("--split", type=click.Choice(["balanced", "uniform"]), default="balanced", show_default=True, help="Where the planes between processors lie.")
@click.option("--batch", type=click.IntRange(1, 8192), default=1024, show_default=True, help="Most packets a message; 1 is the machine of 1983.")
@click.option("--budget", type=click.IntRange(min=1), default=262_144, show_default=True, help="Packets in flight below which new primary rays are admitted.")
@click.option("--transfer", type=click.Choice(["srgb", "linear"]), default="srgb", show_default=True, help="From linear radiance to the bytes of a picture.")
@click.option("-o", "--output", "outputs", multiple=True, type=click.Path(), help="Picture (.png and others), or .npy of the exact sums; may be repeated. [default: the scene's name with .png, here]")
@click.option("--stats", type=click.Path(), help="Write what the machine did as JSON.")
@click.option("--patience", type=click.FloatRange(min=0.1), default=30.0, show_default=True, help="Seconds without progress after which the array is taken to hang.")
@click.option("-q", "--quiet", is_flag=True, help="No talk.")
def render(scene: str, shape: tuple[int, int, int], outputs: tuple[str, ...], **options: Any) -> None:
    """Render SCENE (.nff .obj .ply .stl .glb .gltf .toml) on an array of processes."""
    from raygrid.host.command_render import run_render

    run_render(scene, shape, outputs, **options)


@cli.command()
@click.argument("scene", type=click.Path())
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def info(scene: str, as_json: bool) -> None:
    """Say what is in SCENE."""
    from raygrid.host.load import load_scene
    from raygrid.host.scene import describe

    facts = describe(load_scene(scene))
    click.echo(json.dumps(facts, indent=2) if as_json else "\n".join(_lines(facts)))


def _lines(facts: dict[str, Any], indent: str = "") -> Iterator[str]:
    """Facts as indented text."""
    for name, value in facts.items():
        label = f"{indent}{name.replace('_', ' ')}:"
        if isinstance(value, dict):
            yield label
            yield from _lines(value, indent + "  ")
        elif isinstance(value, list) and value and isinstance(value[0], dict | str):
            yield label
            for item in value:
                yield indent + "  " + (item if isinstance(item, str) else ", ".join(f"{k} {_short(v)}" for k, v in item.items()))
        else:
            yield f"{label} {_short(value)}"


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return " ".join(f"({_short(item)})" if isinstance(item, list) else _short(item) for item in value) or "none"
    return "not set" if value is None else str(value)


@contextlib.contextmanager
def _errors_as_lines(debug: bool) -> Iterator[None]:
    """Known errors become one line and exit code 1; Ctrl-C one line and 130."""
    try:
        yield
    except KeyboardInterrupt:
        click.echo("raygrid: stopped", err=True)
        raise SystemExit(130) from None
    except Exception as error:
        from raygrid.node.errors import RaygridError

        if debug:
            traceback.print_exc()
        if isinstance(error, RaygridError):
            click.echo(f"raygrid: {error}", err=True)
        elif isinstance(error, MemoryError):
            click.echo("raygrid: out of memory", err=True)
        elif debug:
            click.echo("raygrid: that was a bug", err=True)
        else:
            click.echo(f"raygrid: a bug: {type(error).__name__}: {error} (--debug shows where)", err=True)
        raise SystemExit(1) from None


def main(argv: list[str] | None = None) -> None:
    """Run a command. Always ends by SystemExit."""
    arguments = sys.argv[1:] if argv is None else argv
    with _errors_as_lines("--debug" in arguments or bool(os.environ.get("RAYGRID_DEBUG"))):
        try:
            cli.main(args=arguments, prog_name="raygrid", standalone_mode=False)
        except click.exceptions.Abort:
            raise KeyboardInterrupt from None
        except click.exceptions.Exit as end:
            raise SystemExit(end.exit_code) from None
        except click.ClickException as error:
            error.show()
            raise SystemExit(2) from None
    raise SystemExit(0)
