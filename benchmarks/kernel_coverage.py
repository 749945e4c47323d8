"""Runs the tests of kernels without a compiler, and prints how many of the kernels' lines they run.

    python benchmarks/kernel_coverage.py [--least 95] [--processes 2] [TEST ...]

Compiled code cannot be watched line by line, interpreted code can: NUMBA_DISABLE_JIT=1 makes every kernel a plain Python
function, and every formula runs over numpy's numbers. Each file of tests is a process of its own, two at a time. Needs the
package `coverage`. Exits with 1 if a test fails or if fewer lines run than asked for.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from kernel_functions import kernels

ROOT = Path(__file__).resolve().parent.parent
LAYERS = ("node", "emulator")


class Suite(NamedTuple):
    """A file of tests, or a part of it.

    chosen  what of it runs, as pytest's -k has it, slow ones too; "": all that is not marked slow
    """

    file: str
    chosen: str = ""


def _suites(folder: str, names: str) -> tuple[Suite, ...]:
    return tuple(Suite(f"tests/node/{folder}/test_{name}.py") for name in names.split())


# those that take longest first. Left out are whole pictures on many shapes (tests/node/tracing/test_step.py: an hour without
# a compiler), trees of many boxes (test_bvh.py: more than eight minutes), and what is about numba, caches and processes;
# test_interpreted has the whole machine instead
SUITES = (
    Suite("tests/system/test_interpreted.py"),
    *_suites("geometry", "grid_walk power overlap intersect lattice"),
    *_suites("runtime", "event_loop waves timers"),
    Suite("tests/node/runtime/test_profile.py", "not parts_are_those"),  # a frame of processes, which takes minutes so
    Suite("tests/node/runtime/test_reduction.py", "after_the_same_work or python_does_not or range or length"),
    Suite(
        "tests/node/tracing/test_primaries.py", "packets_of_primary or middle_of_its_pixel or without_pixels or one_row"
    ),
    *_suites("tracing", "primary_rays ray_setup step_by_hand ray_classify spawn layer_values"),
    *_suites("tracing", "framebuffer work_queues background no_direction"),
    *_suites("protocol", "packets messages commands timestamps framing"),
    *_suites("geometry", "bvh_refit rounded spanning_tree quaternion"),
    *_suites("jit", "formula intrinsics records switches"),
    *_suites("links", "link link_flow control_channel"),
    Suite("tests/node/programs/test_powers.py"),
    Suite("tests/node/programs/test_programs.py", "background_is_seen"),
)


class Ran(NamedTuple):
    """How a file of tests went.

    code  pytest's; seconds: of processor time; said: what it printed
    """

    suite: Suite
    code: int
    seconds: float
    said: str


def run_suite(suite: Suite, folder: str) -> Ran:
    """Run tests interpreted; what coverage saw is left in the folder."""
    watched = ["-m", "coverage", "run", "--parallel-mode", f"--data-file={folder}/data", f"--source={','.join(LAYERS)}"]
    pytest = ["-m", "pytest", "-q", "-W", "ignore::RuntimeWarning", suite.file]
    command = [sys.executable, *watched, *pytest, *(["-k", suite.chosen] if suite.chosen else ["-m", "not slow"])]
    with tempfile.TemporaryFile("w+") as said:
        environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=said, stderr=subprocess.STDOUT)
        _, status, spent = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        return Ran(suite, process.returncode, spent.ru_utime + spent.ru_stime, said.read())


def run_all(suites: Sequence[Suite], processes: int, folder: str) -> bool:
    """Run them so many at a time, and print how each went; whether all passed."""
    passed = True
    with ThreadPoolExecutor(processes) as pool:
        for ran in pool.map(lambda suite: run_suite(suite, folder), suites):
            passed = passed and ran.code == 0
            print(
                f"{ran.suite.file:58}{ran.seconds:7.0f} s of CPU  {'passed' if ran.code == 0 else 'FAILED'}", flush=True
            )
            if ran.code != 0:
                print(ran.said, flush=True)
    return passed


def read_report(folder: str) -> dict[str, Any]:
    """What coverage saw in all processes together."""
    coverage, data = [sys.executable, "-m", "coverage"], f"--data-file={folder}/data"
    subprocess.run([*coverage, "combine", "-q", data, folder], cwd=ROOT, check=True)
    subprocess.run([*coverage, "json", "-q", data, "-o", f"{folder}/report.json"], cwd=ROOT, check=True)
    found: dict[str, Any] = json.loads(Path(folder, "report.json").read_text())
    return found


def count(report: dict[str, Any]) -> dict[str, tuple[int, int, list[int]]]:
    """Module -> (lines of its kernels, how many of them ran, the others), of a JSON report of coverage."""
    found: dict[str, tuple[int, int, list[int]]] = {}
    for file, facts in report["files"].items():
        for name in kernels(ast.parse((ROOT / file).read_text())):
            if name in facts["functions"]:
                function = facts["functions"][name]
                lines, ran, missing = found.get(file, (0, 0, []))
                ran += len(function["executed_lines"])
                lines += len(function["executed_lines"]) + len(function["missing_lines"])
                found[file] = (lines, ran, sorted(missing + function["missing_lines"]))
    return found


def tell(found: dict[str, tuple[int, int, list[int]]]) -> float:
    """Print a line a module, and all together; returns the share that ran, in percent."""
    all_lines = all_ran = 0
    for file, (lines, ran, missing) in sorted(found.items()):
        all_lines += lines
        all_ran += ran
        print(f"{file:42}{lines:6}{ran / lines:8.1%}  {' '.join(map(str, missing[:12]))}")
    print(f"{'all kernels':42}{all_lines:6}{all_ran / max(all_lines, 1):8.1%}")
    return 100.0 * all_ran / max(all_lines, 1)


def main() -> int:
    """Run, print, and compare with what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--least", type=float, default=0.0, metavar="PERCENT")
    parser.add_argument("--processes", type=int, default=2, metavar="N")
    parser.add_argument("tests", nargs="*", metavar="TEST", help="files of tests, instead of all that run kernels")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        passed = run_all([Suite(test) for test in asked.tests] or SUITES, asked.processes, folder)
        share = tell(count(read_report(folder)))
    if share < asked.least:
        print(f"{share:.1f} % of the kernels' lines ran, wanted {asked.least:g} %", file=sys.stderr)
    return 0 if passed and share >= asked.least else 1


if __name__ == "__main__":
    sys.exit(main())
