"""Runs the tests of kernels without a compiler, and prints how many of the kernels' lines they run.

    python benchmarks/kernel_coverage.py [--least 95] [TEST ...]

Compiled code cannot be watched line by line, interpreted code can: NUMBA_DISABLE_JIT=1 makes every kernel a plain Python
function, and every formula runs over numpy's numbers. Needs the package `coverage`. Exits with 1 if a test fails or if fewer
lines run than asked for.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from kernel_functions import kernels

ROOT = Path(__file__).resolve().parent.parent
LAYERS = ("node", "emulator")
TESTS = (
    "tests/node/tracing",
    "tests/node/geometry",
    "tests/node/protocol",
    *(f"tests/node/jit/test_{name}.py" for name in ("formula", "intrinsics", "records", "switches")),
    *(f"tests/node/links/test_{name}.py" for name in ("link", "link_flow", "control_channel")),
    "tests/node/runtime/test_reduction.py",
    "--ignore=tests/node/tracing/test_step.py",  # whole pictures on many shapes: an hour without a compiler
)


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


def run_tests(tests: list[str], folder: str) -> tuple[int, dict[str, Any]]:
    """Run tests interpreted; returns pytest's exit code and the report."""
    data, report = f"{folder}/data", f"{folder}/report.json"
    coverage = [sys.executable, "-m", "coverage"]
    pytest = ["-m", "pytest", "-q", "-m", "not slow", "-W", "ignore::RuntimeWarning", *tests]
    command = [*coverage, "run", f"--data-file={data}", f"--source={','.join(LAYERS)}", *pytest]
    code = subprocess.run(command, cwd=ROOT, env={**os.environ, "NUMBA_DISABLE_JIT": "1"}).returncode
    subprocess.run([*coverage, "json", f"--data-file={data}", "-q", "-o", report], cwd=ROOT, check=True)
    return code, json.loads(Path(report).read_text())


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
    parser.add_argument("tests", nargs="*", default=list(TESTS), metavar="TEST")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        code, report = run_tests(asked.tests, folder)
    share = tell(count(report))
    if share < asked.least:
        print(f"{share:.1f} % of the kernels' lines ran, wanted {asked.least:g} %", file=sys.stderr)
    return 1 if code or share < asked.least else 0


if __name__ == "__main__":
    sys.exit(main())
