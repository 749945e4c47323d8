"""What pictures, ticks and counts come out, as digests in one file: to prove that a change of the code has changed none.

    python benchmarks/digests.py --write before.json       run everything, keep what came out
    python benchmarks/digests.py --against before.json     run it again; a line for each difference, and exit code 1
    other/.venv/bin/python benchmarks/digests.py --against before.json      the same of another tree's installation

Only the command line is used (`python -m raygrid`), so modules may have moved and changed their names in between. What is kept:

sums    SHA-256 of the .npy files of every scene on every array: frames of shots, programs and other splits among them
ticks   of `raygrid simulate` for two cost models, and of `raygrid render --timed`, with all else that their --stats say
stats   what --stats say, but for the keys of VARIES; nodes one by one
texts   SHA-256 of what `raygrid export`, `trace` and `jam` write

VARIES are the keys whose values differ between two runs of the same code, or could: times, processes, memory, and what depends
on who came first. `--everything` keeps them, too; written and compared so, it shows which they are.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("RAYGRID_SHARED", ROOT.parent / "shared")) / "scenes"
SHAPES = ("1x1x1", "2x1x1", "2x2x2", "3x2x2")
LONGEST = 1800.0  # seconds that one command may take: the first compiles
ABSENT = object()
VARIES = {  # of render
    *("wall_seconds", "busy_seconds", "cpu_seconds", "balance"),  # times
    *("pid", "peak_memory", "private_memory"),  # processes
    *("messages", "bytes", "waves", "most_in_flight", "most_waiting", "most_queued_messages"),  # who came first
    *("memory.backlog", "memory.outputs", "memory.links"),  # what was needed at the busiest moment
}
VARIES_SIMULATED = {"wall_seconds"}
STEADY = {"machine"}  # maps of machine time: all that stands in them is the same in every run

# A scene, and what else the command gets. {out} is the beginning of the names of files that it writes.
SMALL = "--size 64x64 -o {out}.npy --stats {out}.json"
SHOT = "-o {out}_%02d.npy --stats {out}_%02d.json"
RENDERED = (
    ("scenes/tiny.nff", SMALL),
    ("scenes/faces.nff", SMALL),
    ("scenes/kinds.nff", "--size 96x80 --samples 2 -o {out}.npy --stats {out}.json"),
    ("scenes/kinds.nff", "--split uniform --batch 1 --budget 64 --highlights " + SMALL),
    ("scenes/tree.nff", "--split uniform " + SMALL),
    ("scenes/glass.toml", "--size 96x54 --samples 2 -o {out}.npy --stats {out}.json"),  # refraction; directional, point
    ("scenes/lights.toml", "--samples 1 " + SMALL),  # spots, points that fall off
    ("scenes/room.glb", "--samples 1 " + SMALL),
    ("scenes/room.obj", "--samples 1 " + SMALL),
    ("scenes/checker.obj", SMALL),
    ("scenes/mobile.toml", "--frames 20-22 --samples 1 --size 64x48 " + SHOT),  # increments, keys of all kinds
    ("scenes/checker.obj", "--turntable-scene 3 --size 64x64 " + SHOT),
    ("scenes/rings.toml", "--allow-programs --program scenes/programs/torus.py --samples 1 " + SMALL),
    ("scenes/marble.toml", "--allow-programs --program scenes/programs/marble.py --samples 1 " + SMALL),
    ("spd/balls_2.nff", SMALL),
    ("spd/gears_1.nff", SMALL),  # polygons, refraction
    ("spd/mount_4.nff", SMALL),
    ("spd/rings_2.nff", SMALL),
    ("spd/teapot_3.nff", SMALL),  # smooth triangles
    ("spd/tetra_5.nff", SMALL),
    ("meshes/BoxTextured.glb", SMALL),  # textures
    ("meshes/Duck.glb", SMALL),
    ("meshes/spot_triangulated.obj", SMALL),
)
SIMULATED = ("scenes/kinds.nff", "scenes/glass.toml", "scenes/room.glb", "scenes/mobile.toml --frame 21")
SIMULATE = "--samples 1 --size 24x20 --array 3x2x2 -o {out}.npy --stats {out}.json --csv {out}.csv --cost "
TIMED = ("scenes/kinds.nff", "--timed --cost t800 --array 2x2x1 --size 12x10 -o {out}.npy --stats {out}.json")
SPOKEN = (
    "export scenes/kinds.nff -o -",
    "trace scenes/tiny.nff --pixel 128,128",
    "jam scenes/kinds.nff --room 256 --size 48x48",
)


@dataclass(frozen=True)
class Case:
    """A command to run: its words, the scene that must be there, and the keys of statistics that are left out."""

    words: str
    scene: str
    varies: frozenset[str] | set[str] = frozenset()


def cases() -> Iterator[Case]:
    """Everything that is run."""
    for scene, options in RENDERED:
        for shape in SHAPES:
            yield Case(f"render {scene} --array {shape} {options}", scene, VARIES)
    for words in SIMULATED:
        for model in ("8086", "t800 --search tree"):
            yield Case(f"simulate {words} {SIMULATE}{model}", words.split()[0], VARIES_SIMULATED)
    yield Case(f"render {TIMED[0]} {TIMED[1]}", TIMED[0], VARIES)
    for words in SPOKEN:
        yield Case(words, words.split()[1])


def place(name: str) -> Path:
    """Where a scene or program is: in this tree, or among the shared ones."""
    return ROOT / name if name.startswith("scenes/") else SHARED / name


def outcome(case: Case, everything: bool) -> dict[str, Any]:
    """Run a command; what came out, by the names of files. Raises SystemExit with its last words if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        words = [str(place(word)) if word in (case.scene, *_programs(case)) else word for word in case.words.split()]
        words = [word.replace("{out}", f"{folder}/out") for word in words]
        command = [sys.executable, "-m", "raygrid", *words]
        done = subprocess.run(command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, timeout=LONGEST)
        if done.returncode != 0:
            sys.exit(
                f"raygrid {case.words} failed with {done.returncode}: {done.stderr.decode(errors='replace')[-500:]}"
            )
        found: dict[str, Any] = {}
        for file in sorted(Path(folder).iterdir()):
            if file.suffix == ".json":
                stats = json.loads(file.read_text())
                found[file.name] = stats if everything else steady(stats, case.varies)
            else:
                found[file.name] = hashlib.sha256(file.read_bytes()).hexdigest()
        if not found:
            found["standard output"] = hashlib.sha256(done.stdout).hexdigest()
        return found


def _programs(case: Case) -> list[str]:
    return [word for word in case.words.split() if word.startswith("scenes/programs/")]


def steady(value: Any, varies: frozenset[str] | set[str], name: str = "") -> Any:
    """Statistics without what differs between two runs of the same code; `name` is the key that they stand under."""
    if isinstance(value, dict) and name not in STEADY:
        kept = {key: each for key, each in value.items() if not {key, f"{name}.{key}"} & varies}
        return {key: steady(each, varies, key) for key, each in kept.items()}
    return [steady(each, varies) for each in value] if isinstance(value, list) else value


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """(name, leaf) of everything in maps and lists."""
    if isinstance(value, dict | list) and value:
        for key, each in value.items() if isinstance(value, dict) else enumerate(value):
            yield from flat(each, f"{name}: {key}" if name else str(key))
    else:
        yield name, value


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """A line for each leaf that is not the same in both."""
    old, new = dict(flat(before)), dict(flat(after))
    lines = []
    for name in sorted(old.keys() | new.keys()):
        was, came = old.get(name, ABSENT), new.get(name, ABSENT)
        if was is ABSENT or came is ABSENT:
            lines.append(f"{name}: " + ("only before" if came is ABSENT else "only now"))
        elif was != came:
            lines.append(f"{name}: {was} before, {came} now")
    return lines


def main() -> None:
    """Run all cases, or those with a text in their command, and write or compare what came out."""
    parser = argparse.ArgumentParser(description="Digests of pictures, ticks and counts: written, or compared.")
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("--write", type=Path, metavar="FILE")
    task.add_argument("--against", type=Path, metavar="FILE")
    parser.add_argument("--only", default="", metavar="TEXT", help="only commands that contain it")
    parser.add_argument("--everything", action="store_true", help="keep what varies from run to run, too")
    options = parser.parse_args()
    before = json.loads(options.against.read_text()) if options.against else {}
    now: dict[str, Any] = {}
    for case in cases():
        if options.only not in case.words:
            continue
        if not place(case.scene).is_file():
            print(f"left out, {case.scene} is not in $RAYGRID_SHARED: raygrid {case.words}", file=sys.stderr)
            continue
        print(f"raygrid {case.words}", file=sys.stderr, flush=True)
        now[case.words] = outcome(case, options.everything)
        if options.write:  # each time, so that a run that is ended keeps what it has
            options.write.write_text(json.dumps(now, indent=1) + "\n")
    if not now:
        parser.error(f"no command contains {options.only!r}")
    if options.write:
        return
    found = differences({words: each for words, each in before.items() if options.only in words}, now)
    print("\n".join(found) or f"{len(now)} commands, all as before")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
