"""Says what commands there are and what options they take, and runs them.

Heavy libraries are imported by the commands that need them, so that --help is quick. Results go to standard output,
progress and errors to standard error; `ending` has the exit codes.
"""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Iterator, Mapping
from typing import Any, cast

import click

from raygrid.host.cli import group_inspect, group_machine_time, group_service, group_start
from raygrid.host.cli.conventions import apply_conventions
from raygrid.host.cli.ending import DEBUG, leave, run
from raygrid.host.cli.types import (
    CostName,
    FaultType,
    FileName,
    FramesType,
    LayersType,
    NumberType,
    PairType,
    SceneName,
    ShapeType,
    debug_option,
    outside_option,
    path_option,
)
from raygrid.host.cli.view_options import view_options
from raygrid.host.text.bounds import MAX_BUDGET, MAX_DEPTH, MAX_FRAMES, MAX_RATE, MAX_SAMPLES, MAX_WEIGHT
from raygrid.host.text.standard_streams import ready_streams

# Of what a command imports nearly all stays: looking it through for cycles as often as by default takes a sixth of the time.
FEWER_LOOKS = (50_000, 20, 100)
# numpy's threads would wait in a busy loop, beside the nodes, for matrices that are too small for them
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

EXAMPLES = """\b
Examples:
  raygrid demo
  raygrid render scenes/room.glb
  raygrid render scenes/glass.toml --array 3x3x3 --samples 4 -o glass.png
  raygrid render scenes/mobile.toml --frames 1-48 -o 'out/m_%04d.png'
  raygrid render scenes/kinds.nff --split uniform -o kinds.npy
  raygrid simulate scenes/kinds.nff --array 10x10x10 --cost 8086
  raygrid info scenes/room.glb
  raygrid export scenes/kinds.nff -o kinds.pov
  raygrid up --array 2x2x2
  raygrid submit scenes/room.glb -o room.png

Variables such as RAYGRID_ARRAY and RAYGRID_NAME have defaults of options; the help of a command names those that it takes,
and docs/commands.md has them all.
"""
RENDER_EXAMPLES = """\b
Examples:
  raygrid render scenes/room.glb
  raygrid render scenes/glass.toml --array 3x3x3 --samples 4 -o glass.png
  raygrid render scenes/checker.obj -o a.png -o a.npy --stats a.json
  raygrid render scenes/room.obj --fit front --light 2,7,4 -o front.png
  raygrid render scenes/glass.toml --from 3,2,6 --at 0,1,0 --fov 30
  raygrid render scenes/tree.nff --array 4x4x1 --split uniform --batch 1
  raygrid render scenes/mobile.toml --frames 1-48 -o 'out/m_%04d.png'
  raygrid render scenes/glass.toml --turntable 72 -o out/round.webp
  raygrid render scenes/rings.toml --allow-programs \\
      --program scenes/programs/torus.py -o rings.png
  raygrid render scenes/glass.toml --layers depth,normal -o g.png -o g.npy

.npy holds the exact sums as int64, height x width x 3: linear radiance x 2^24, added over the samples of a pixel.
docs/stats.md says what the statistics mean, docs/probes.md what probes tell, docs/animation.md how scenes move.
"""
LOAD_EXAMPLES = """\b
Examples:
  raygrid load scenes/programs/torus.py --allow-programs
  raygrid render scenes/rings.toml --allow-programs \\
      --program scenes/programs/torus.py -o rings.png
"""
INFO_EXAMPLES = """\b
Examples:
  raygrid info scenes/room.glb
  raygrid info --json scenes/checker.obj
"""
EXPORT_EXAMPLES = """\b
Examples:
  raygrid export scenes/kinds.nff
  raygrid export scenes/room.glb --depth 3 -o room.pov
  raygrid export scenes/glass.toml -o glass.glb
"""


@click.group(epilog=EXAMPLES, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="raygrid")
@debug_option
def cli() -> None:
    """The parallel ray tracing computer of 1983: processors that each own a box of space and talk to their neighbours."""


# fmt: off
@cli.command(epilog=RENDER_EXAMPLES)
@click.argument("scene", type=SceneName())
@click.option("--array", "shape", type=ShapeType(), default="2x2x2", show_default=True, metavar="NXxNYxNZ",
              help="Processors on each axis.")
@click.option("--size", type=PairType(), metavar="WxH", help="Pixels.  [default: what the scene asks for, else 512x512]")
@click.option("--samples", type=NumberType(1, MAX_SAMPLES), metavar="N", help="Samples a pixel.  [default: the scene's, else 1]")
@click.option("--depth", type=NumberType(1, MAX_DEPTH), metavar="N",
              help="Depth of the last hit that is lit, 1 to 31; the eye's ray has depth 1.  [default: the scene's, else 5]")
@click.option("--min-weight", type=NumberType(0.0, MAX_WEIGHT), metavar="WEIGHT",
              help="Rays fainter than this are not born.  [default: the scene's, else 0]")
@click.option("--highlights/--no-highlights", default=None, help="Phong highlights.  [default: off for NFF, else on]")
@click.option("--split", type=click.Choice(["balanced", "uniform"]), default="balanced", show_default=True,
              help="Where the planes between processors lie: so that work is spread, or in equal boxes.")
@click.option("--batch", type=NumberType(1, 8192), default=4096, show_default=True, metavar="PACKETS",
              help="Most packets a message; 1 is the machine of 1983.")
@click.option("--budget", type=NumberType(1, MAX_BUDGET), default=1 << 20, show_default=True, metavar="PACKETS",
              help="Packets in flight below which new primary rays are admitted.")
@click.option("--transfer", type=click.Choice(["srgb", "linear"]), default="srgb", show_default=True,
              help="From linear radiance to the bytes of a picture.")
@click.option("-o", "--output", "outputs", multiple=True, type=FileName(), metavar="FILE",
              help="Picture (.png .jpg .webp .tif .bmp .ppm .tga .jp2), linear radiance (.pfm .hdr .exr), or .npy of the exact "
                   "sums; - is standard output, a PNG; may be repeated.  [default: the scene's name with .png, here]")
@click.option("--layers", type=LayersType(), default=(), metavar="NAME,...",
              help="Besides, of the first surface behind the middle of each pixel: depth, normal, surface (its number), material. "
                   "An .exr holds them; beside others they are NAME.LAYER.SUFFIX (docs/layers.md).")
@click.option("--frames", type=FramesType(), metavar="A-B",
              help="Render these frames of a shot; FILE then has a number such as %04d in its name, or is .gif .webp .mp4.")
@click.option("--turntable", type=NumberType(1, MAX_FRAMES), metavar="N", help="The camera goes once round the scene in N frames.")
@click.option("--turntable-scene", type=NumberType(1, MAX_FRAMES), metavar="N",
              help="The scene turns once in N frames, under lights that stay.")
@click.option("--resume", is_flag=True,
              help="Skip frames whose files are there, whole, and of just this shot: a .png says so itself, others are "
                   "rendered again.")
@click.option("--program", type=FileName(), metavar="FILE",
              help="Code for the nodes: a surface, a shading rule or a background (docs/programs.md).")
@click.option("--allow-programs", is_flag=True, help="Launch an array that takes programs. They run with your rights.")
@path_option("--stats", metavar="FILE", help="Write what the machine did as JSON; - is standard output.")
@path_option("--probe-record", metavar="FILE",
              help="Keep how every node stood, line by line, as JSON. For a single frame.")
@path_option("--chrome-trace", metavar="FILE",
              help="Write the same as a trace for Perfetto. For a single frame.")
@click.option("--probe-rate", type=NumberType(0.01, MAX_RATE), default=10.0, show_default=True, metavar="HZ",
              help="How often a node tells how it stands, if anybody asks.")
@click.option("--profile", is_flag=True,
              help="Say where each processor's time went: receive, birth, decode, walk, hit, shade, send, other, wait. "
                   "For a single frame.")
@click.option("--patience", type=NumberType(0.1, 1e9), default=30.0, show_default=True, metavar="SECONDS",
              help="Time without any progress after which the array is taken to hang.")
@click.option("--timed", is_flag=True, help="Keep machine time, too: ticks in --stats. Slow; see docs/machine-time.md.")
@click.option("--cost", type=CostName(), metavar="MODEL", help="With --timed, what work costs; as for simulate.  [default: 8086]")
@click.option("--search", type=click.Choice(["list", "tree"]), help="With --timed; as for simulate.")
@click.option("--attempts", type=NumberType(1, 1000), default=4, show_default=True, metavar="N",
              help="How often to try when processors are lost or links break; the picture is the same.")
@click.option("--fault", type=FaultType(), metavar="KIND[:RATE[:SEED]]",
              help="For experiments: links between neighbours drop, double, reorder, delay, corrupt or truncate this part "
                   "of their messages; --patience is then 3 at most.  [default rate: 0.0001]")
@view_options
@click.option("-q", "--quiet", is_flag=True, help="No talk but errors. (Without a terminal there is hardly any.)")
@outside_option
@debug_option
def render(scene: str, shape: tuple[int, int, int], outputs: tuple[str, ...], **options: Any) -> None:
    """Render a scene file on an array of processes.

    SCENE is a file of one of these kinds: .nff .obj .ply .stl .glb .gltf .toml
    """
    from raygrid.host.cli.commands.render import run_render
    from raygrid.host.cli.commands.render_request import RenderRequest
    from raygrid.host.image.frames import default_outputs, turntable_of, wants_shot
    from raygrid.host.render.given_settings import GivenSettings

    of_machine = ("batch", "budget", "transfer", "stats", "patience", "attempts", "fault", "quiet", "profile")
    names = (*of_machine, "probe_record", "chrome_trace", "probe_rate", "frames", "program", "allow_programs", "resume", "layers")
    machine = {name: options.pop(name) for name in names}
    timed, cost, search = (options.pop(name) for name in ("timed", "cost", "search"))
    if not timed and (cost or search):
        raise click.UsageError("--cost and --search came without --timed")
    machine |= {"cost": (cost or "8086") if timed else None, "search": search}
    turntable = turntable_of(options.pop("turntable"), options.pop("turntable_scene"))
    several = wants_shot(machine["frames"], turntable is not None, outputs, machine["stats"])
    if timed and (several or machine["program"] is not None):
        raise click.UsageError("--timed came with --frames, --turntable or --program, wanted one frame without a program")
    if several and (machine["profile"] or machine["probe_record"] or machine["chrome_trace"]):
        raise click.UsageError("--profile, --probe-record or --chrome-trace came with several frames, wanted a single one")
    outputs = outputs or default_outputs(scene, several)
    request = RenderRequest(scene, shape, outputs, **machine, settings=cast(GivenSettings, options), turntable=turntable)
    if request.resume and not several:
        raise click.UsageError("--resume came without frames, wanted --frames, --turntable, or a number such as %04d in a name")
    run_render(request)


@cli.command(epilog=LOAD_EXAMPLES)
@click.argument("program", type=FileName())
@click.option("--array", "shape", type=ShapeType(), default="2x2x2", show_default=True, metavar="NXxNYxNZ",
              help="Processors on each axis.")
@click.option("--allow-programs", is_flag=True, help="Launch an array that takes programs. They run with your rights.")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@click.option("-q", "--quiet", is_flag=True, help="No talk but errors.")
@debug_option
def load(program: str, shape: tuple[int, int, int], allow_programs: bool, as_json: bool, quiet: bool) -> None:
    """Try a program on an array of processes.

    PROGRAM is a file as docs/programs.md describes it. Every node checks, compiles and tries it; what is compiled stays on
    disk, so that `raygrid render --program` begins at once.
    """
    from raygrid.host.cli.commands.load import run_load

    run_load(program, shape, allow_programs, quiet, as_json)


@cli.command(epilog=INFO_EXAMPLES)
@click.argument("scene", type=SceneName())
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@outside_option
@debug_option
def info(scene: str, as_json: bool) -> None:
    """Say what is in a scene file.

    SCENE is a file of one of these kinds: .nff .obj .ply .stl .glb .gltf .toml
    """
    from raygrid.host.image.outputs import write_lines, write_result
    from raygrid.host.scene.load import load_scene
    from raygrid.host.scene.scene import describe

    facts = describe(load_scene(scene))
    write_result(json.dumps(facts, indent=2)) if as_json else write_lines(_lines(facts))


@cli.command(short_help="Write a scene for another program: .pov, .glb, .obj, .ply.", epilog=EXPORT_EXAMPLES)
@click.argument("scene", type=SceneName())
@click.option("--depth", type=NumberType(1, MAX_DEPTH), metavar="N",
              help="As for render; for .pov alone.  [default: the scene's, else 5]")
@click.option("--highlights/--no-highlights", default=None,
              help="As for render; for .pov and .glb.  [default: off for NFF, else on]")
@path_option(
    "-o",
    "--output",
    metavar="FILE",
    help="File to write.  [default: the scene's name with .pov, here]",
)
@click.option("--frame", type=NumberType(1, MAX_FRAMES), metavar="N", help="The frame of a shot.  [default: 1]")
@view_options
@outside_option
@debug_option
def export(
    scene: str, depth: int | None, highlights: bool | None, output: str | None, frame: int | None, **view: Any
) -> None:
    """Write a scene for another program: .pov, .glb, .obj, .ply or .stl.

    POV-Ray 3.7 renders the same picture from a .pov, by the same rules; its head says what differs. A .glb has triangles,
    materials, camera and lights for modelling programs; the others hold the triangles. What is not in them is said.

    SCENE is a file of one of these kinds: .nff .obj .ply .stl .glb .gltf .toml
    """
    from raygrid.host.export.scene_file import export_file
    from raygrid.host.image.outputs import write_names

    written = [
        export_file(scene, output, depth, highlights, frame, lambda told: click.echo(f"note: {told}", err=True), **view)
    ]
    write_names(written, written)


group_machine_time.add_commands(cli)
group_service.add_commands(cli, render)
group_inspect.add_commands(cli)
group_start.add_commands(cli)
apply_conventions(cli)


def _lines(facts: Mapping[str, object], indent: str = "") -> Iterator[str]:
    """Facts as indented text."""
    from raygrid.host.text.clean_text import printable

    for name, value in facts.items():
        label = f"{indent}{name.replace('_', ' ')}:"
        if isinstance(value, dict):
            yield label
            yield from _lines(value, indent + "  ")
        elif isinstance(value, list) and value and isinstance(value[0], dict | str):
            yield label
            for item in value:
                yield (
                    indent
                    + "  "
                    + (printable(item) if isinstance(item, str) else ", ".join(f"{k} {_short(v)}" for k, v in item.items()))
                )
        else:
            yield f"{label} {_short(value)}"


def _short(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return " ".join(f"({_short(item)})" if isinstance(item, list) else _short(item) for item in value) or "none"
    return "not set" if value is None else str(value)


def main(argv: list[str] | None = None) -> None:
    """Run a command. Always ends by SystemExit; as a program (no argv) it has ended then, with all files written."""
    arguments = sys.argv[1:] if argv is None else argv
    if "--debug" in arguments:
        os.environ[DEBUG] = "1"  # the nodes look for it, too
    if argv is not None:
        raise SystemExit(run(cli, arguments))
    ready_streams()
    gc.set_threshold(*FEWER_LOOKS)
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
    code = run(cli, arguments)
    leave(code)
    raise SystemExit(code)
