"""Declares the commands for arrays that stay: up, list, submit, wait, jobs, cancel, status, reset, down."""

from __future__ import annotations

import os
from typing import Any, cast

import click
from click.shell_completion import CompletionItem

from raygrid.host.cli.types import (
    AnyType,
    Command,
    FileName,
    FramesType,
    NumberType,
    SceneName,
    ShapeType,
    debug_option,
    path_option,
)
from raygrid.host.render.given_settings import SETTINGS, GivenSettings
from raygrid.host.text.bounds import MAX_JOB, MAX_PRIORITY, MOST_LISTED

# Options of `render` that a job has, too; the others belong to the array, and so to `up`.
OF_RENDER = (*SETTINGS, "budget", "transfer", "turntable", "turntable_scene", "program")

UP_EXAMPLES = """\b
Examples:
  raygrid up --array 2x2x2
  raygrid up --array 4x4x4 --name film
  raygrid up --name film --prometheus 9400

Jobs that were not done when the array of that name was taken down, or crashed, go on.
"""
LIST_EXAMPLES = """\b
Examples:
  raygrid list
  raygrid list --json
"""
SUBMIT_EXAMPLES = """\b
Examples:
  raygrid submit scenes/room.glb -o room.png
  raygrid submit scenes/mobile.toml --frames 1-48 -o out/m_%04d.png --resume
  raygrid submit scenes/glass.toml --turntable 72 -o out/round.webp
  raygrid submit scenes/glass.toml --turntable 72 --name film --detach
  raygrid submit scenes/glass.toml --size 64x64 --priority 10

Ctrl-C cancels the job. If this command is killed, or its terminal closed, the job goes on: raygrid jobs shows it.
"""
WAIT_EXAMPLES = """\b
Examples:
  raygrid wait 3
"""
JOBS_EXAMPLES = """\b
Examples:
  raygrid jobs
  raygrid jobs --ended 100 --json
"""
CANCEL_EXAMPLES = """\b
Examples:
  raygrid cancel 3
  raygrid cancel --all --name film
"""
STATUS_EXAMPLES = """\b
Examples:
  raygrid status
  raygrid status --watch
  raygrid status --name film --json
"""
RESET_EXAMPLES = """\b
Examples:
  raygrid reset
  raygrid reset --name film
"""
DOWN_EXAMPLES = """\b
Examples:
  raygrid down
  raygrid down --finish --name film
"""


class ArrayNameType(AnyType):
    """The name of an array that stays."""

    name = "name"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Raises a usage error for what cannot be one."""
        from raygrid.host.client.service_files import check_array_name
        from raygrid.node.errors import ArrayError

        try:
            check_array_name(str(value))
        except ArrayError as error:
            self.fail(str(error), param, ctx)
        return str(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """The arrays that are up."""
        from raygrid.host.client.service_files import running

        return [CompletionItem(array.name) for array in running() if array.name.startswith(incomplete)]


def _name_option(command: Command) -> Command:
    text = "Of the array; several can be up at once."
    option = click.option(
        "--name", type=ArrayNameType(), default="default", show_default=True, metavar="NAME", help=text
    )
    return option(command)


def _json_option(command: Command) -> Command:
    return click.option("--json", "as_json", is_flag=True, help="As JSON.")(command)


# fmt: off
@click.command(epilog=UP_EXAMPLES)
@click.option("--array", "shape", type=ShapeType(), default="2x2x2", show_default=True, metavar="NXxNYxNZ",
              help="Processors on each axis.")
@_name_option
@click.option("--batch", type=NumberType(1, 8192), default=4096, show_default=True, metavar="PACKETS",
              help="Most packets a message; 1 is the machine of 1983.")
@click.option("--patience", type=NumberType(0.1, 1e9), default=30.0, show_default=True, metavar="SECONDS",
              help="Time without any progress after which the array is taken to hang.")
@click.option("--allow-programs", is_flag=True, help="Take programs. They run with your rights.")
@click.option("--allow-outside", is_flag=True,
              help="Let the scenes of all jobs refer to files outside their folders. They are read with your rights.")
@click.option("--prometheus", type=NumberType(0, 65535), metavar="PORT",
              help="Serve figures of jobs, queue, frames and faults at http://127.0.0.1:PORT/metrics; 0: any free port.")
@_json_option
@click.option("-q", "--quiet", is_flag=True, help="No talk but errors.")
def up(**options: Any) -> None:
    """Launch an array that stays, and return when it is ready."""
    from raygrid.host.cli.commands.up import UpRequest, run_up

    run_up(UpRequest(**options))


@click.command("list", epilog=LIST_EXAMPLES)
@_json_option
def list_arrays(as_json: bool) -> None:
    """List the arrays that are up: shape, state, since when, jobs."""
    from raygrid.host.cli.commands.list import run_list

    run_list(as_json)


@click.command(short_help="Render frames of a scene on an array that stays.", epilog=SUBMIT_EXAMPLES)
@click.argument("scene", type=SceneName())
@_name_option
@click.option("--frames", type=FramesType(), metavar="A-B", help="As for render.")
@click.option("-o", "--output", "outputs", multiple=True, type=FileName(), metavar="FILE",
              help="As for render, but for standard output. May be repeated.  "
                   "[default: the scene's name with .png, or with _%04d.png, here]")
@path_option("--stats", metavar="FILE", help="As for render; %04d as for -o.")
@click.option("--resume", is_flag=True, help="Skip frames whose files are there, whole, and of just this job.")
@click.option("--priority", type=NumberType(-MAX_PRIORITY, MAX_PRIORITY), default=0, show_default=True, metavar="N",
              help="Frames of jobs with a higher one go first.")
@click.option("--detach", is_flag=True, help="Print the number of the job and return at once.")
@click.option("--json", "as_json", is_flag=True, help="Print a line of JSON for each event.")
@click.option("-q", "--quiet", is_flag=True, help="No talk but errors.")
def submit(scene: str, **options: Any) -> None:
    """Render frames of a scene on an array that stays, and follow them.

    SCENE is a file as for render. The service reads it, and writes the outputs, by their absolute paths.
    """
    from raygrid.host.cli.commands.submit import SubmitRequest, run_submit
    from raygrid.host.image.frames import turntable_of

    settings = cast(GivenSettings, {name: options.pop(name) for name in SETTINGS})
    turntable = turntable_of(options.pop("turntable"), options.pop("turntable_scene"))
    client = f"session {os.getsid(0)}"
    run_submit(SubmitRequest(scene=scene, settings=settings, turntable=turntable, client=client, **options))


@click.command(epilog=WAIT_EXAMPLES)
@click.argument("job", type=NumberType(1, MAX_JOB))
@_name_option
@click.option("--json", "as_json", is_flag=True, help="Print a line of JSON for each event.")
@click.option("-q", "--quiet", is_flag=True, help="No talk but errors.")
def wait(job: int, **options: Any) -> None:
    """Follow a job until it has ended. Ctrl-C leaves it alone."""
    from raygrid.host.cli.commands.submit import run_wait

    run_wait(job, **options)


@click.command(short_help="List the jobs of an array, also of one that is not up.", epilog=JOBS_EXAMPLES)
@_name_option
@click.option("--ended", type=NumberType(0, MOST_LISTED), default=10, show_default=True, metavar="N",
              help="How many of the jobs that have ended.")
@_json_option
def jobs(**options: Any) -> None:
    """List the jobs of an array: the last that have ended, and all that have not.

    Of an array that is not up they are read out of its journal.
    """
    from raygrid.host.cli.commands.array import run_jobs

    run_jobs(**options)


@click.command(epilog=CANCEL_EXAMPLES)
@click.argument("numbers", metavar="JOB...", nargs=-1, type=NumberType(1, MAX_JOB))
@click.option("--all", "everything", is_flag=True, help="All jobs.")
@_name_option
@_json_option
def cancel(numbers: tuple[int, ...], everything: bool, name: str, as_json: bool) -> None:
    """Cancel jobs. Frames that are done stay; a frame that is being traced is given up."""
    from raygrid.host.cli.commands.array import run_cancel

    if bool(numbers) == everything:
        raise click.UsageError("wanted either numbers of jobs or --all", click.get_current_context())
    run_cancel(name, None if everything else list(numbers), as_json)


@click.command(short_help="Say how an array is: nodes, load, queue, frames and faults.", epilog=STATUS_EXAMPLES)
@_name_option
@click.option("--watch", is_flag=True, help="Say it again and again, until Ctrl-C or the array's end.")
@click.option("--every", type=NumberType(0.1, 86_400.0), default=1.0, show_default=True, metavar="SECONDS", help="With --watch.")
@_json_option
def status(**options: Any) -> None:
    """Say how an array is: its nodes, load, queue, frames and faults."""
    from raygrid.host.cli.commands.array import run_status

    run_status(**options)


@click.command(short_help="Empty an array; the running frame is begun again.", epilog=RESET_EXAMPLES)
@_name_option
@_json_option
def reset(name: str, as_json: bool) -> None:
    """Empty an array, whatever its state; the running frame is begun again."""
    from raygrid.host.cli.commands.array import run_reset

    run_reset(name, as_json)


@click.command(epilog=DOWN_EXAMPLES)
@_name_option
@click.option("--finish", is_flag=True, help="When all jobs have ended; no more are taken meanwhile.")
@click.option("--cancel", is_flag=True, help="Cancel all jobs. Without it they go on when the array is up again.")
@click.option("--kill", is_flag=True, help="Kill a service that does not answer.")
@_json_option
def down(**options: Any) -> None:
    """End an array and wait until no process of it is left."""
    from raygrid.host.cli.commands.array import run_down

    if options["kill"] and (options["finish"] or options["cancel"]):
        raise click.UsageError("--kill came with --finish or --cancel, wanted it alone", click.get_current_context())
    run_down(**options)
# fmt: on


def add_commands(group: click.Group, render: click.Command) -> None:
    """Add the commands to the command line. `render` has the options that a job has, too."""
    shared = [option for option in render.params if option.name in OF_RENDER]
    submit.params[2:2] = shared
    for command in (up, list_arrays, submit, wait, jobs, cancel, status, reset, down):
        debug_option(command)
        group.add_command(command)
