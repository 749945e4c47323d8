"""Scenes with numbers at their extremes: each gives the same bits on every array, or one sentence, within ten seconds.

    python benchmarks/fuzz_scenes.py                          2,000 scenes, the tables of docs/faults.md on standard output
    python benchmarks/fuzz_scenes.py --scenes 200 --seed 7
    python benchmarks/fuzz_scenes.py --case 1234              one scene again, its text and what comes of it

A scene is a text of `fuzz_scenes_texts`, in which one to four numbers are exchanged for extreme ones; the first of them
goes over all numbers of the text in turn, so that every field has its share. Each scene is read and rendered in a
process of its own by the array in memory, in four shapes; a share of those that were rendered goes to real processes
afterwards, in the same shapes, and must give the same bits once more.
"""

from __future__ import annotations

import argparse
import faulthandler
import hashlib
import json
import os
import select
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from fuzz_scenes_texts import FORMATS, Case, make_case

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.emulator.processes.warm import warm
from raygrid.host.image.picture import Picture
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import RaygridError, SceneError

SHAPES = ((1, 1, 1), (2, 1, 1), (2, 2, 2), (4, 3, 1))
SIZE = (15, 11)  # odd, so that a ray runs through the middle of the picture
DEPTH = 4
LIMIT = 10.0  # seconds a scene may take, in all four shapes
SENTENCE = 600  # characters that one sentence has at most
SHARE = 12  # every so manieth scene that is rendered goes to processes as well
SETTINGS = Settings(size=SIZE, samples=1, depth=DEPTH)  # by their own depth some scenes would take their time honestly
RIGHT, REFUSED = "same bits", "one sentence"


class Outcome(NamedTuple):
    """What came of a scene: RIGHT, REFUSED, or else what is wrong with it."""

    what: str
    told: str
    digest: str
    seconds: float


Renderers = dict[tuple[int, int, int], Callable[[Job], Picture]]


def in_memory() -> Renderers:
    """Arrays of each shape inside this process, with their links up: for processes forked from it."""
    renderers: Renderers = {}
    for shape in SHAPES:
        array = MemoryArray(shape)
        array.driver.ready()
        renderers[shape] = partial(render_job, array.driver)
    return renderers


def tried(path: Path, renderers: Renderers) -> Outcome:
    """Read a scene and render it in each of these ways, in this process."""
    begun = time.perf_counter()
    digests: dict[str, str] = {}
    what, told = "", ""
    try:
        scene = load_scene(path)
        for shape, render in renderers.items():
            picture = render(make_job(scene, shape, SETTINGS))
            digests["x".join(map(str, shape))] = hashlib.sha256(np.ascontiguousarray(picture.sums)).hexdigest()[:16]
        what = RIGHT if len(set(digests.values())) == 1 else f"other bits: {digests}"
    except SceneError as error:
        what, told = REFUSED if not digests else "refused after it was rendered", str(error)
        if "\n" in told or len(told) > SENTENCE:
            what = "no sentence"
    except RaygridError as error:
        what, told = f"an error of the array: {type(error).__name__}", str(error)
    except Exception as error:
        what, told = f"a bug: {type(error).__name__}: {error}", traceback.format_exc().strip().splitlines()[-3].strip()
    return Outcome(what, told, next(iter(digests.values()), ""), time.perf_counter() - begun)


def tried_apart(path: Path, renderers: Renderers) -> Outcome:
    """The same in a process of its own, which is killed when its time is over."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            with os.fdopen(writing, "wb") as out:
                out.write(json.dumps(tried(path, renderers)).encode())
        finally:
            os._exit(0)
    os.close(writing)
    said, begun = b"", time.perf_counter()
    while (left := begun + LIMIT - time.perf_counter()) > 0 and select.select([reading], [], [], left)[0]:
        piece = os.read(reading, 1 << 16)
        said += piece
        if not piece:
            break
    else:
        os.kill(child, signal.SIGKILL)
    os.close(reading)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    seconds = time.perf_counter() - begun
    if status == -signal.SIGKILL:
        return Outcome(f"takes more than {LIMIT:g} s", "", "", seconds)
    if status or not said:
        return Outcome(f"ended by {status}", "", "", seconds)
    return Outcome(*json.loads(said))


def in_processes(paths: dict[int, Path], digests: dict[int, str]) -> dict[int, Outcome]:
    """Render these scenes on real processes, shape by shape; what came of each that did not give its digest again."""
    wrong: dict[int, Outcome] = {}
    for shape in SHAPES:
        array = Array.launch(shape)
        try:
            for number, path in paths.items():
                outcome = tried(path, {shape: partial(render_job, array.driver)})
                if outcome.what == RIGHT and outcome.digest != digests[number]:
                    outcome = outcome._replace(what=f"other bits in processes, {shape}")
                if outcome.what != RIGHT or outcome.seconds > LIMIT:
                    wrong[number] = outcome
                    array.close()
                    array = Array.launch(shape)
        finally:
            array.close()
    return wrong


def campaign(seed: int, scenes: int, folder: Path, share: int = SHARE) -> tuple[list[tuple[int, Case, Outcome]], int]:
    """Try all scenes; returns what came of each, and how many went to processes as well."""
    warm(lambda *_: None)
    renderers, results = in_memory(), []
    paths, digests = {}, {}
    for number in range(scenes):
        case = make_case(seed, number)
        place = folder / str(number)
        place.mkdir()
        path = case.write(place)
        outcome = tried_apart(path, renderers)
        results.append((number, case, outcome))
        if outcome.what == RIGHT and len(digests) * share <= sum(one.what == RIGHT for _, _, one in results) - 1:
            paths[number], digests[number] = path, outcome.digest
        if outcome.what not in (RIGHT, REFUSED):
            print(f"{number}: {outcome.what}; {outcome.told}; {case.changes}", file=sys.stderr, flush=True)
    for number, outcome in in_processes(paths, digests).items():
        _, case, _ = results[number]
        results[number] = (number, case, outcome)
        print(f"{number}: {outcome.what}; {outcome.told}; {case.changes}", file=sys.stderr, flush=True)
    return results, len(paths)


def table(results: list[tuple[int, Case, Outcome]], apart: int, seed: int) -> str:
    """The figures, as in docs/faults.md."""
    lines = ["| scenes | tried | same bits on all arrays | one sentence | anything else | longest, s |"]
    lines.append("|---|---|---|---|---|---|")
    for name in (*FORMATS, "all"):
        mine = [outcome for _, case, outcome in results if name in (case.format, "all")]
        counts = Counter(outcome.what if outcome.what in (RIGHT, REFUSED) else "" for outcome in mine)
        longest = max((outcome.seconds for outcome in mine), default=0.0)
        lines.append(f"| {name} | {len(mine)} | {counts[RIGHT]} | {counts[REFUSED]} | {counts['']} | {longest:.2f} |")
    lines.append("")
    lines.append(
        f"Seed {seed}; {apart} of the scenes that were rendered went to real processes as well, in all shapes."
    )
    return "\n".join(lines)


def build_parser() -> argparse.ArgumentParser:
    """The arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=2000, metavar="N")
    parser.add_argument("--seed", type=int, default=1983, metavar="N")
    parser.add_argument("--case", type=int, metavar="N", help="only this one, in this process")
    return parser


def main() -> int:
    """Run; 0 if nothing was wrong."""
    arguments = build_parser().parse_args()
    faulthandler.enable()
    with tempfile.TemporaryDirectory(prefix="fuzz-scenes-") as folder:
        if arguments.case is not None:
            case = make_case(arguments.seed, arguments.case)
            for name, text in case.files.items():
                print(f"--- {name}\n{text}")
            print(*case.changes, sep="\n")
            print(tried(case.write(Path(folder)), in_memory()))
            return 0
        begun = time.perf_counter()
        results, apart = campaign(arguments.seed, arguments.scenes, Path(folder))
    print(table(results, apart, arguments.seed))
    wrong = [one for one in results if one[2].what not in (RIGHT, REFUSED) or one[2].seconds > LIMIT]
    print(f"{len(wrong)} wrong; {time.perf_counter() - begun:.0f} s", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
