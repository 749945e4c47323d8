"""The fixed suite of measurements: prints Markdown, and writes it to a file if asked.

    python benchmarks/bench.py                         all of it, about half an hour
    python benchmarks/bench.py --quick --only c        one run of little
    python benchmarks/bench.py --write docs/performance.md

    a  against POV-Ray               d  overhead of the array at 2048x2048
    b  on 1, 8 and 64 processes      e  a large frame and a large mesh
    c  start-up                      f  the kernel against Embree

Figures are wall-clock and CPU seconds of this computer, not of the machine of 1983. Repeated runs alternate, A B A B;
what is printed is the median, with the least and the most in brackets, and ratios are ratios of medians.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.metadata
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import bench_arrays
import bench_embree
import bench_large
import bench_povray
import bench_start
from bench_run import BenchError, render, run, tell
from bench_tables import Section, document, with_head_kept

RUNS = {"a": 5, "b": 3, "c": 7, "d": 3, "e": 1, "f": 1}  # where --runs does not say
PACKAGES = ("raygrid", "numpy", "numba", "llvmlite", "pyzmq", "msgpack", "trimesh")


def sections(quick: bool, runs: int | None) -> dict[str, Callable[[], Section]]:
    """What each letter measures."""

    def times(letter: str) -> int:
        return 1 if quick and runs is None else runs or RUNS[letter]

    shapes = bench_arrays.SHAPES[:2] if quick else bench_arrays.SHAPES
    names = ("kinds.nff", "tetra_6") if quick else bench_arrays.OWN + bench_arrays.SPD
    return {
        "a": lambda: bench_povray.measure(times("a"), ("tetra_6",) if quick else bench_povray.SCENES),
        "b": lambda: bench_arrays.measure(times("b"), names, shapes, 512),
        "c": lambda: bench_start.measure(times("c"), ("2x2x2",) if quick else ("2x2x2", "4x4x4")),
        "d": lambda: bench_arrays.measure_overhead(
            times("d"), ("tetra_6",) if quick else bench_arrays.OVERHEAD, shapes, 512 if quick else 2048
        ),
        "e": lambda: bench_large.measure(times("e"), 512 if quick else 4000, 20_000 if quick else 1_000_000),
        "f": lambda: bench_embree.measure(() if quick else bench_embree.SCENES),
    }


def head(arguments: list[str]) -> list[str]:
    """When, where and with what."""
    versions = [f"{name} {_version(name)}" for name in PACKAGES]
    others = [f"POV-Ray {bench_povray.povray_version()}", f"embreex {_version('embreex')}"]
    load = os.getloadavg()[0]
    command = " ".join(["python benchmarks/bench.py", *arguments])
    return [
        "## The suite",
        "",
        f"Measured {datetime.datetime.now(datetime.UTC):%Y-%m-%d %H:%M} UTC by `{command}`"
        f" at commit {_commit()}.",
        "",
        f"Computer: {_processor()}, {len(os.sched_getaffinity(0))} cores for us, {_memory()} GiB of memory; "
        f"{platform.system()} {platform.release()}; load when it began: {load:.1f}.",
        "",
        f"Python {platform.python_version()}, {', '.join(versions)}; {', '.join(others)}.",
        "",
        "Wall-clock and CPU seconds of this computer, not of the machine of 1983. It is shared and noisy, so"
        " what is compared runs in turn, A B A B; figures are medians, with the least and the most in brackets, and"
        " ratios are ratios of medians. Figures of one scene in one table compare well, others less.",
    ]  # fmt: skip


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _commit() -> str:
    try:
        hash_ = run(["git", "rev-parse", "--short", "HEAD"]).output.strip()
        return hash_ + (" with changes" if run(["git", "status", "--porcelain"]).output.strip() else "")
    except BenchError:
        return "unknown"


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _memory() -> int:
    return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30)


def parse(arguments: list[str]) -> argparse.Namespace:
    """The options. Ends the program with code 2 if they are none."""
    about = (__doc__ or "").split("\n\n")
    parser = argparse.ArgumentParser(
        description="\n\n".join(about), formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few scenes, one run")
    parser.add_argument("--only", default="a,b,c,d,e,f", metavar="a,b,...", help="only these parts")
    parser.add_argument("--runs", type=int, metavar="N", help="runs of each thing")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the Markdown there, too")
    options = parser.parse_args(arguments)
    options.only = [letter for letter in options.only.replace(",", " ").split() if letter]
    unknown = sorted(set(options.only) - set(RUNS))
    if unknown or not options.only:
        parser.error(f"--only {' '.join(unknown) or 'nothing'} came, wanted letters of {' '.join(RUNS)}")
    if options.runs is not None and options.runs < 1:
        parser.error(f"--runs {options.runs} came, wanted 1 or more")
    if options.write is not None and not options.write.absolute().parent.is_dir():
        parser.error(f"--write {options.write} came, and there is no directory {options.write.absolute().parent}")
    return options


def main(arguments: list[str]) -> None:
    """Measure, print, write."""
    options = parse(arguments)
    begun = time.monotonic()
    made, top = [], head(arguments)
    with tempfile.TemporaryDirectory() as folder:  # so that nothing is compiled while it is measured
        tell("once before: raygrid render scenes/tiny.nff")
        try:
            render(bench_start.TINY, Path(folder))
        except BenchError as error:
            sys.exit(f"bench: {error}")
    for letter, measure in sections(options.quick, options.runs).items():
        if letter not in options.only:
            continue
        tell(f"{letter}: {time.monotonic() - begun:.0f} s so far")
        try:
            made.append(measure())
        except BenchError as error:
            made.append(Section(f"{letter}.", [f"{error}."]))
    text = document(top, made)
    print(text, end="")
    if options.write is not None:
        old = options.write.read_text() if options.write.is_file() else ""
        options.write.write_text(with_head_kept(old, text))
    tell(f"done in {time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main(sys.argv[1:])
