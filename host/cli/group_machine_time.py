"""Declares the commands of machine time: simulate, predict and law."""

from __future__ import annotations

import sys
from typing import Any, cast

import click

from raygrid.host.cli.types import (
    CostName,
    EdgesType,
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
from raygrid.host.text.bounds import MAX_DEPTH, MAX_FRAMES, MAX_SAMPLES, MAX_WEIGHT

SIMULATE_EXAMPLES = """\b
Examples:
  raygrid simulate scenes/room.glb --array 10x10x10 --cost 8086
  raygrid simulate tetra_6.nff --array 50x50x50 --split uniform --no-band
  raygrid simulate scenes/kinds.nff --cost t800 --search tree \\
      --stats kinds.json --csv nodes.csv --plots .

Machine seconds are those of the machine that the cost model describes. docs/machine-time.md says how time is counted,
docs/costs.md what the cost models mean and where they come from.
"""
PREDICT_EXAMPLES = """\b
Examples:
  raygrid predict scenes/room.glb --array 10x10x10 --cost 8086
  raygrid predict tetra_6.nff --array 10x10x10 --array 50x50x50 --cost t800 \\
      --size 1000x1000
  raygrid predict scenes/kinds.nff --array 4x4x4 --cost mine.toml --json

docs/predict.md says how the times are told, what the errors mean, and how often they hold.
"""
LAW_EXAMPLES = """\b
Examples:
  raygrid law tetra_6.nff --cost 8086
  raygrid law tetra_5.nff mount_4.nff --square 1,2,4,8,16,32 --cubic 1,2,4,8 \\
      --size 32x32 --size 64x64 -o report

Writes law.md, law.csv and a plot for each scene. docs/paper.md says what came out for the standard scenes.
"""


# fmt: off
@click.command(short_help="Simulate an array in machine time: how long a frame would take.", epilog=SIMULATE_EXAMPLES)
@click.argument("scene", type=SceneName())
@click.option("--array", "shape", type=ShapeType(), default="2x2x2", show_default=True, metavar="NXxNYxNZ",
              help="Processors on each axis: 50x50x50 and more.")
@click.option("--cost", type=CostName(), default="8086", show_default=True, metavar="MODEL",
              help="What work costs in ticks: 8086, 8086-soft, t800, unit, modern, or a .toml file.")
@click.option("--search", type=click.Choice(["list", "tree"]),
              help="How a node looks for hits: tests all it holds, or walks its hierarchy.  [default: the cost model's]")
@click.option("--band/--no-band", default=True, show_default=True,
              help="Low and high costs, too: three frames instead of one.")
@click.option("--size", type=PairType(), metavar="WxH", help="As for render.")
@click.option("--samples", type=NumberType(1, MAX_SAMPLES), metavar="N", help="As for render.")
@click.option("--depth", type=NumberType(1, MAX_DEPTH), metavar="N", help="As for render.")
@click.option("--min-weight", type=NumberType(0.0, MAX_WEIGHT), metavar="WEIGHT", help="As for render.")
@click.option("--highlights/--no-highlights", default=None, help="As for render.")
@click.option("--split", type=click.Choice(["balanced", "uniform"]), default="balanced", show_default=True,
              help="As for render.")
@click.option("--transfer", type=click.Choice(["srgb", "linear"]), default="srgb", show_default=True,
              help="As for render.")
@click.option("--frame", type=NumberType(1, MAX_FRAMES), metavar="N", help="The frame of a shot.  [default: 1]")
@click.option("-o", "--output", "outputs", multiple=True, type=FileName(), metavar="FILE",
              help="Picture, or .npy of the exact sums: the same bits as from render; may be repeated.")
@path_option("--stats", metavar="FILE", help="Write what the machine did as JSON.")
@path_option("--csv", "table", metavar="FILE", help="Write a row for each processor.")
@path_option("--plots", metavar="FOLDER",
              help="Write busy.png, links.png and time.png there, made if need be (needs the extra `plots`).")
@view_options
@click.option("--json", "as_json", is_flag=True, help="What came out as JSON, as --stats writes it.")
@click.option("-q", "--quiet", is_flag=True, help="No talk but errors and results.")
@outside_option
@debug_option
def simulate(scene: str, shape: tuple[int, int, int], outputs: tuple[str, ...], **options: Any) -> None:
    """Simulate an array in machine time: how long a frame would take, and why.

    All processors are simulated in one process, with the ray step, the packets and the walk of the real ones, so the
    picture is the same, and so are the ticks of render --timed.

    SCENE is a file of one of these kinds: .nff .obj .ply .stl .glb .gltf .toml
    """
    from raygrid.host.cli.commands.simulate import SimulateRequest, run_simulate

    names = ("cost", "search", "band", "stats", "table", "plots", "transfer", "quiet", "frame", "as_json")
    chosen = {name: options.pop(name) for name in names}
    if chosen["as_json"] and "-" in (*outputs, chosen["stats"], chosen["table"]):
        raise click.UsageError("--json came with -, wanted one of them on standard output", click.get_current_context())
    run_simulate(SimulateRequest(scene, shape, outputs=outputs, **chosen, settings=cast(GivenSettings, options)))


@click.command(short_help="Predict the machine time of a frame on any arrays, in seconds.", epilog=PREDICT_EXAMPLES)
@click.argument("scene", type=SceneName())
@click.option("--array", "shapes", type=ShapeType(), multiple=True, metavar="NXxNYxNZ",
              help="Processors on each axis; may be repeated, with a row for each.  [default: 2x2x2]")
@click.option("--cost", type=CostName(), default="8086", show_default=True, metavar="MODEL", help="As for simulate.")
@click.option("--search", type=click.Choice(["list", "tree"]), help="As for simulate.")
@click.option("--size", type=PairType(), metavar="WxH", help="As for render.")
@click.option("--samples", type=NumberType(1, MAX_SAMPLES), metavar="N", help="As for render.")
@click.option("--depth", type=NumberType(1, MAX_DEPTH), metavar="N", help="As for render.")
@click.option("--min-weight", type=NumberType(0.0, MAX_WEIGHT), metavar="WEIGHT", help="As for render.")
@click.option("--split", type=click.Choice(["balanced", "uniform"]), default="balanced", show_default=True,
              help="As for render.")
@click.option("--frame", type=NumberType(1, MAX_FRAMES), metavar="N", help="The frame of a shot.  [default: 1]")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@click.option("-q", "--quiet", is_flag=True, help="No talk but errors and results.")
@outside_option
@debug_option
def predict(scene: str, shapes: tuple[tuple[int, int, int], ...], **options: Any) -> None:
    """Predict how long a frame, its set-up and its read-out would take on each array, and what that may be off by.

    Pictures with few pixels are counted and simulated; the work of the busiest processor makes the rest of them. Takes about
    two seconds, however many pixels the frame has. Arrays of which few rays meet a processor are told with larger errors.

    SCENE is a file of one of these kinds: .nff .obj .ply .stl .glb .gltf .toml
    """
    from raygrid.host.cli.commands.predict import PredictRequest, run_predict

    names = ("cost", "search", "as_json", "quiet", "frame")
    chosen = {name: options.pop(name) for name in names}
    run_predict(PredictRequest(scene, shapes or ((2, 2, 2),), **chosen, settings=options))


@click.command(short_help="Fit the law of 1983, T = A + B n + C R / n^2, to simulations.", epilog=LAW_EXAMPLES)
@click.argument("scenes", nargs=-1, required=True, type=SceneName())
@click.option("--cost", type=CostName(), default="8086", show_default=True, metavar="MODEL", help="As for simulate.")
@click.option("--search", type=click.Choice(["list", "tree"]), help="As for simulate.")
@click.option("--square", type=EdgesType(), default="1,2,3,4,6,8,12,16,24,32", show_default=True, metavar="N,N,...",
              help="Edges of square arrays.")
@click.option("--cubic", type=EdgesType(), default="1,2,3,4,6,8,10", show_default=True, metavar="N,N,...",
              help="Edges of cubic arrays.")
@click.option("--size", "pictures", type=PairType(), multiple=True, metavar="WxH",
              help="Pixels, for the number of rays; may be repeated.  [default: 32x32, 64x64, 128x128]")
@click.option("--axis", type=click.Choice(["x", "y", "z", "view"]), default="view", show_default=True,
              help="The axis that square arrays leave whole; view: the one along which the camera looks.")
@click.option("--depth", type=NumberType(1, MAX_DEPTH), metavar="N", help="As for render.")
@click.option("--split", type=click.Choice(["balanced", "uniform"]), default="uniform", show_default=True,
              help="As for render.")
@path_option("-o", "--output", "folder", default=("law",), metavar="FOLDER",
              help="Where the report goes.  [default: law]")
@click.option("-q", "--quiet", is_flag=True, help="No talk but errors and results.")
@outside_option
@debug_option
def law(scenes: tuple[str, ...], folder: str, **options: Any) -> None:
    """Fit the law of 1983 to simulated frames: T = A + B n + C R / n^2 on n x n processors, C R / n^3 on n x n x n.

    Simulates every array with every picture, says how well the law holds, which size is best, and whether a square or
    a cubic array does better with as many processors (needs the extra `law`).
    """
    from raygrid.host.cli.commands.law import LawRequest, run_law

    pictures = options["pictures"] or ((32, 32), (64, 64), (128, 128))
    along = None if options["axis"] == "view" else "xyz".index(options["axis"])
    settings = {name: options[name] for name in ("depth", "split") if options[name] is not None}
    edges = {"square": options["square"], "cubic": options["cubic"]}
    command = " ".join(["raygrid", *sys.argv[1:]])
    cost, search, quiet = options["cost"], options["search"], options["quiet"]
    run_law(LawRequest(scenes, cost, search, edges, pictures, along, folder, quiet, command, settings))
# fmt: on


def add_commands(group: click.Group) -> None:
    """Add them to a group."""
    for command in (simulate, predict, law):
        group.add_command(command)
