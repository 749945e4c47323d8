"""Carries out `raygrid load`: tries a program on an array."""

from __future__ import annotations

import json
import time

from raygrid.emulator.processes import Array
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.image.outputs import write_result
from raygrid.host.scene.load import check_allowed
from raygrid.node.errors import ArrayError


def run_load(path: str, shape: tuple[int, int, int], allowed: bool, quiet: bool, as_json: bool = False) -> None:
    """Launch an array, load a program, and say what the nodes run. Raises RaygridError."""
    check_allowed(path, allowed)
    with ProgressReporter(quiet) as reporter, Array(shape, on_warming=reporter.warming, programs=allowed) as array:
        array.begin()
        from raygrid.host.render.program_file import read_program

        program = read_program(path)
        reporter.phase("launching the processors")
        array.wait_ready()
        reporter.phase(f"compiling and trying {program.name}")
        begun = time.perf_counter()
        array.driver.load_program(program)
        seconds = time.perf_counter() - begun
        running = [node["program"] for node in array.driver.report()]
        reporter.phase("ending the processors")
    if set(running) != {program.digest}:
        raise ArrayError(f"{path}: {running.count(program.digest)} of {len(running)} nodes run the program, wanted all")
    if as_json:
        hooks = sorted(program.hooks)
        facts = {"program": program.name, "hooks": hooks, "digest": program.digest, "nodes": len(running)}
        write_result(json.dumps(facts | {"wall_seconds": round(seconds, 3)}, indent=2))
        return
    functions = ", ".join(sorted(program.hooks))
    write_result(
        f"{len(running)} nodes run {program.name} ({functions}), digest {program.digest[:16]}, "
        f"loaded in {seconds:.2f} s"
    )
