"""Declares the commands that help to begin: demo, schema, completion."""

from __future__ import annotations

from typing import Any

import click

from raygrid.host.cli.types import FileName, NumberType, PairType, ShapeType, debug_option
from raygrid.host.text.bounds import MAX_SAMPLES

DEMO_EXAMPLES = """\b
Examples:
  raygrid demo
  raygrid demo --array 3x3x1 --size 1280x960 -o big.png
  raygrid demo --print
"""
SCHEMA_EXAMPLES = """\b
Examples:
  raygrid schema
  raygrid schema scene
  raygrid schema cost

An editor that knows TOML (such as those with Taplo) checks and completes a
scene file whose first line names the file into which you put the schema:
#:schema ./scene.schema.json
"""
COMPLETION_EXAMPLES = """\b
Examples:
  raygrid completion bash
  raygrid completion zsh
  raygrid completion fish

\b
What is printed is for the shell, in each session or its start-up file:
  bash, ~/.bashrc:   eval "$(raygrid completion bash)"
  zsh, ~/.zshrc:     eval "$(raygrid completion zsh)"
  fish:              raygrid completion fish | source

Commands, options, names of files, choices, cost models and the names of arrays that are up are completed.
"""
SCHEMAS = ("scene", "cost", "request", "sample")
SHELLS = ("bash", "zsh", "fish")
COMPLETES = "_RAYGRID_COMPLETE"  # the variable by which a shell asks, as click has it


# fmt: off
@click.command(short_help="Render a scene that raygrid brings with it.", epilog=DEMO_EXAMPLES)
@click.option("--array", "shape", type=ShapeType(), default="2x2x2", show_default=True, metavar="NXxNYxNZ",
              help="Processors on each axis.")
@click.option("--size", type=PairType(), metavar="WxH", help="Pixels.  [default: 640x480]")
@click.option("--samples", type=NumberType(1, MAX_SAMPLES), metavar="N", help="Samples a pixel.  [default: 4]")
@click.option("-o", "--output", "outputs", multiple=True, type=FileName(), metavar="FILE",
              help="As for render; may be repeated.  [default: demo.png]")
@click.option("--print", "printed", is_flag=True, help="Print the scene's file instead: a beginning for your own.")
@click.option("-q", "--quiet", is_flag=True, help="No talk but errors.")
def demo(shape: tuple[int, int, int], printed: bool, **options: Any) -> None:
    """Render a scene that raygrid brings with it: mirrors, glass and gold.

    Nothing but the installed package is needed. A first run compiles the kernels, once: about a minute.
    """
    from raygrid.host.cli.commands.demo import print_demo, run_demo

    if printed:
        print_demo()
        return
    group = click.get_current_context().find_root().command
    assert isinstance(group, click.Group)
    run_demo(group.commands["render"], array=shape, **options)


@click.command(epilog=SCHEMA_EXAMPLES)
@click.argument("kind", type=click.Choice(SCHEMAS), metavar="[KIND]", required=False)
def schema(kind: str | None) -> None:
    """Print the JSON schema of a file, for editors and programs.

    KIND is what is described; without it the kinds are listed.
    """
    from raygrid.host.cli.commands.schema import run_schema

    run_schema(kind)


@click.command(epilog=COMPLETION_EXAMPLES)
@click.argument("shell", type=click.Choice(SHELLS), metavar="SHELL")
def completion(shell: str) -> None:
    """Print what lets a shell complete commands, options and names.

    SHELL is bash (4.4 or later), zsh or fish.
    """
    from click.shell_completion import get_completion_class

    from raygrid.host.image.outputs import write_result

    found = get_completion_class(shell)
    assert found is not None
    write_result(found(click.get_current_context().find_root().command, {}, "raygrid", COMPLETES).source())
# fmt: on


def add_commands(group: click.Group) -> None:
    """Add the commands to a group."""
    for command in (demo, schema, completion):
        debug_option(command)
        group.add_command(command)
