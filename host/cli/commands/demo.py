"""Carries out `raygrid demo`: renders a scene that every installation has."""

from __future__ import annotations

from importlib import resources
from typing import Any

import click

from raygrid.host.image.outputs import write_result

SCENE = "demo.toml"


def demo_path() -> str:
    """Where the scene is."""
    return str(resources.files("raygrid.host.scene") / SCENE)


def print_demo() -> None:
    """Print the scene's file, with nothing before and after it."""
    with open(demo_path(), encoding="utf-8") as file:
        write_result(file.read().removesuffix("\n"))


def run_demo(render: click.Command, outputs: tuple[str, ...], quiet: bool, **options: Any) -> None:
    """Render the scene as `raygrid render` does, whose command this is, with these of its options. Raises RaygridError."""
    words = [demo_path(), *(word for output in outputs or ("demo.png",) for word in ("-o", output))]
    for name, value in options.items():
        if value is not None:
            words += [f"--{name}", "x".join(map(str, value)) if isinstance(value, tuple) else str(value)]
    parent = click.get_current_context().parent
    with render.make_context("render", words + ["--quiet"] * quiet, parent=parent) as context:
        render.invoke(context)
