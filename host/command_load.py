"""The command `raygrid load`: try a program on an array."""

from __future__ import annotations

import time

from raygrid.emulator.array import Array
from raygrid.host.load import check_allowed
from raygrid.host.outputs import write_result
from raygrid.host.progress import Talk
from raygrid.node.errors import ArrayError


def run_load(path: str, shape: tuple[int, int, int], allowed: bool, quiet: bool) -> None:
    """Launch an array, load a program, and say what the nodes run. Raises RaygridError."""
    check_allowed(path, allowed)
    with Talk(quiet) as talk, Array(shape, on_warming=talk.warming, programs=allowed) as array:
        array.begin()
        from raygrid.host.program_file import read_program

        program = read_program(path)
        talk.phase("launching the processors")
        array.wait_ready()
        talk.phase(f"compiling and trying {program.name}")
        begun = time.perf_counter()
        array.driver.load_program(program)
        seconds = time.perf_counter() - begun
        running = [node["program"] for node in array.driver.report()]
        talk.phase("ending the processors")
    if set(running) != {program.digest}:
        raise ArrayError(f"{path}: {running.count(program.digest)} of {len(running)} nodes run the program, wanted all")
    functions = ", ".join(sorted(program.hooks))
    write_result(
        f"{len(running)} nodes run {program.name} ({functions}), digest {program.digest[:16]}, "
        f"loaded in {seconds:.2f} s"
    )
