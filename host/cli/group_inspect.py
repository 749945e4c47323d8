"""Declares the commands that look into the machine: trace, jam, probe, doctor."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import click

from raygrid.host.cli.group_service import ArrayNameType
from raygrid.host.cli.types import (
    AnyType,
    Command,
    FileName,
    NumberType,
    PairType,
    SceneName,
    ShapeType,
    debug_option,
    outside_option,
    path_option,
)
from raygrid.host.cli.view_options import view_options
from raygrid.host.render.given_settings import GivenSettings
from raygrid.host.text.bounds import MAX_BUDGET, MAX_DEPTH, MAX_FRAMES, MAX_RATE, MAX_SAMPLES, MAX_WEIGHT

TRACE_EXAMPLES = """\b
Examples:
  raygrid trace scenes/tiny.nff --pixel 128,128
  raygrid trace scenes/glass.toml --pixel 400,300 --array 3x3x3 --sample 2
  raygrid trace scenes/room.glb --pixel 20,10 --size 64x48 --json

The picture's pixel 0,0 is top left. The sums printed are those of the .npy of `raygrid render`; docs/trace.md says more.
"""
PROBE_EXAMPLES = """\b
Examples:
  raygrid probe
  raygrid probe --name big --rate 2 --json
  raygrid probe --record probes.jsonl --prometheus 9400
  raygrid probe --replay probes.jsonl --speed 0.2
  raygrid probe --replay probes.jsonl --worst
  raygrid probe --replay probes.jsonl --table
  raygrid probe --replay probes.jsonl --chrome-trace trace.json

docs/probes.md says what samples mean, and what they cost.
"""
JAM_EXAMPLES = """\b
Examples:
  raygrid jam scenes/tiny.nff
  raygrid jam scenes/kinds.nff --array 3x3x3 --room 256 --budget 8
  raygrid jam scenes/glass.toml --size 128x96 --json

docs/deadlock.md has what this shows, with counts.
"""
DOCTOR_EXAMPLES = """\b
Examples:
  raygrid doctor
  raygrid doctor --json

docs/doctor.md says more.
"""


class PixelType(AnyType):
    """A pixel, `200,150`."""

    name = "place"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Raises a usage error for anything else."""
        numbers = str(value).split(",")
        if len(numbers) != 2 or not all(
            number.isascii() and number.isdigit() and len(number) < 10 for number in numbers
        ):
            self.fail(f"{str(value)[:40]!r} came, wanted column and row such as 200,150", param, ctx)
        return int(numbers[0]), int(numbers[1])


# fmt: off
def _frame_options(command: Command) -> Command:
    """The options of `render` that say what is traced, for commands that trace in memory."""
    options = (
        click.option("--array", "shape", type=ShapeType(), default="2x2x2", show_default=True, metavar="NXxNYxNZ",
                     help="Processors on each axis."),
        click.option("--size", type=PairType(), metavar="WxH", help="Pixels, as for render."),
        click.option("--samples", type=NumberType(1, MAX_SAMPLES), metavar="N", help="Samples a pixel, as for render."),
        click.option("--depth", type=NumberType(1, MAX_DEPTH), metavar="N",
                     help="Depth of the last hit that is lit, as for render."),
        click.option("--min-weight", type=NumberType(0.0, MAX_WEIGHT), metavar="WEIGHT",
                     help="Least weight of rays, as for render."),
        click.option("--highlights/--no-highlights", default=None, help="Phong highlights, as for render."),
        click.option("--split", type=click.Choice(["balanced", "uniform"]), default="balanced", show_default=True,
                     help="Where the planes between processors lie, as for render."),
        click.option("--frame", type=NumberType(1, MAX_FRAMES), metavar="N", help="The frame of a shot.  [default: 1]"),
    )
    command = view_options(command)
    for option in reversed(options):
        command = option(command)
    return command


@click.command(short_help="Print the tree of rays of one pixel: what each hit and brought.", epilog=TRACE_EXAMPLES)
@click.argument("scene", type=SceneName())
@click.option("--pixel", type=PixelType(), required=True, metavar="X,Y", help="Column and row, 0,0 top left.")
@click.option("--sample", type=NumberType(0, MAX_SAMPLES), metavar="K", help="This sample of the pixel only.  [default: all]")
@_frame_options
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@outside_option
def trace(
    scene: str, shape: tuple[int, int, int], pixel: tuple[int, int], sample: int | None, as_json: bool,
    frame: int | None, **settings: Any
) -> None:
    """Print the tree of rays of one pixel: where each went, what it hit, what came back.

    SCENE is a file of one of these kinds: .nff .obj .ply .stl .glb .gltf .toml
    """
    from raygrid.host.cli.commands.trace import TraceRequest, run_trace

    run_trace(TraceRequest(scene, shape, pixel, sample, as_json, frame, cast(GivenSettings, settings)))


@click.command(epilog=JAM_EXAMPLES)
@click.argument("scene", type=SceneName())
@click.option("--room", type=NumberType(1, 1 << 20), default=64, show_default=True, metavar="PACKETS",
              help="What the buffer of a link holds, each way.")
@click.option("--budget", type=NumberType(1, MAX_BUDGET), metavar="RAYS",
              help="Primary rays alive at once, with admission.  [default: as many as can surely not jam, 1 at least]")
@_frame_options
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@outside_option
def jam(
    scene: str, shape: tuple[int, int, int], room: int, budget: int | None, as_json: bool, frame: int | None,
    **settings: Any
) -> None:
    """Let a naive machine jam: finite buffers, no admission. Then the same load with admission.

    An experiment in one process, by the ray step of the machine itself; the default size is 64x64.
    SCENE is a file of one of these kinds: .nff .obj .ply .stl .glb .gltf .toml
    """
    from raygrid.host.cli.commands.jam import JamRequest, run_jam

    run_jam(JamRequest(scene, shape, room, budget, as_json, frame, cast(GivenSettings, settings)))


@click.command(short_help="Show how the nodes of an array stand: a table and heat maps.", epilog=PROBE_EXAMPLES)
@click.option("--name", type=ArrayNameType(), metavar="NAME", help="Of the array that is up.  [default: default]")
@click.option("--replay", type=FileName(), metavar="FILE", help="Show a recording instead of an array.")
@click.option("--speed", type=NumberType(0.001, 1e9), metavar="X",
              help="Play the recording X times as fast as it was.  [default: 1 on a terminal, unless files are written]")
@click.option("--worst", is_flag=True, help="Show the recording's worst moment: when most packets waited in the array.")
@click.option("--table", is_flag=True, help="At the end, all nodes by the share of a processor that they used.")
@click.option("--rate", type=NumberType(0.01, MAX_RATE), default=10.0, show_default=True, metavar="HZ",
              help="How often each node tells how it stands.")
@click.option("--for", "seconds", type=NumberType(0.0, 1e9), metavar="SECONDS", help="End after this time.  [default: at Ctrl-C]")
@click.option("--json", "as_json", is_flag=True, help="A line of JSON a sample, instead of the table.")
@path_option("--record", metavar="FILE", help="Keep the samples there, as lines of JSON.")
@path_option("--chrome-trace", metavar="FILE", help="Write a trace for Perfetto at the end.")
@click.option("--prometheus", type=NumberType(0, 65535), metavar="PORT", help="Serve aggregates at http://127.0.0.1:PORT/metrics.")
def probe(**options: Any) -> None:
    """Show how the nodes of an array stand: a table, and a heat map of each layer.

    Probes only read: pictures are the same bits with and without.
    """
    source = click.get_current_context().get_parameter_source("name")
    if options["replay"] is not None and source is click.core.ParameterSource.ENVIRONMENT:
        options["name"] = None
    if options["replay"] is not None and (options["name"] is not None or options["prometheus"] is not None):
        raise click.UsageError("--replay came with --name or --prometheus, wanted a recording or an array")
    if options["replay"] is None and (options["speed"] is not None or options["worst"]):
        raise click.UsageError("--speed or --worst came without --replay, wanted a recording")
    if options["worst"] and (options["table"] or options["speed"] is not None):
        raise click.UsageError("--worst came with --table or --speed, wanted one of them")
    from raygrid.host.cli.commands.probe import ProbeRequest, run_probe

    request = ProbeRequest(**options)
    written = options["record"] or options["chrome_trace"]
    if request.replay is not None and request.speed is None and request.is_drawn and not written:
        request = replace(request, speed=1.0)
    run_probe(request)


@click.command(short_help="Say what raygrid finds on this computer, and what stops it.", epilog=DOCTOR_EXAMPLES)
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def doctor(as_json: bool) -> None:
    """Say what raygrid finds on this computer, and what would stop it.

    Versions, fast paths, the cache of compiled kernels, limits, places for files. It only looks.
    """
    from raygrid.host.cli.commands.doctor import run_doctor

    run_doctor(as_json)
# fmt: on


def add_commands(group: click.Group) -> None:
    """Add the commands to a group."""
    for command in (trace, jam, probe, doctor):
        debug_option(command)
        group.add_command(command)
