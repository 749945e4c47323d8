"""How long it takes until the nodes of an array are ready: a JSON map a launch.

    python benchmarks/ready.py --array 2x2x2 --array 4x4x4 --runs 5

`warm`: seconds from starting the fork server until its kernels are ready (loaded from the cache on disk, or compiled).
`ready`: seconds from then until all nodes are forked and every link of every node is up. `end`: until all are gone.
"""

from __future__ import annotations

import argparse
import json
import time

import raygrid.host.render.api  # noqa: F401  (what the host imports is not what is measured here)
from raygrid.emulator.processes.array import Array
from raygrid.emulator.topology.limits import parse_shape

LONGEST = 300.0  # seconds; a first run compiles


def launched(shape: str) -> dict[str, object]:
    """Launch an array and end it."""
    with Array(parse_shape(shape)) as array:
        begun = time.perf_counter()
        array.begin()
        # The launch alone, after the warm-up: Array itself has no way of waiting for the one without the other.
        assert array._fork_server is not None
        array._fork_server.wait_warm(LONGEST)
        warm = time.perf_counter()
        array.wait_ready()
        ready = time.perf_counter()
    return {"array": shape, "warm": warm - begun, "ready": ready - warm, "end": time.perf_counter() - ready}


def main() -> None:
    """Print a line a launch, the arrays in turn."""
    parser = argparse.ArgumentParser(description="Seconds until the nodes of an array are ready, a JSON map a launch.")
    parser.add_argument("--array", action="append", required=True, metavar="NXxNYxNZ")
    parser.add_argument("--runs", type=int, default=3, metavar="N")
    options = parser.parse_args()
    for _ in range(options.runs):
        for shape in options.array:
            print(json.dumps(launched(shape)), flush=True)


if __name__ == "__main__":
    main()
