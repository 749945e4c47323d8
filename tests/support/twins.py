"""Small frames by every part of the machine that has kernels, told as facts that compiled and interpreted kernels must agree on.

python -m support.twins          all facts as JSON, of kernels as this process has them (NUMBA_DISABLE_JIT)
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any
from unittest import mock

import numba
import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.analysis.deadlock_model import NaiveMachine
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.partition import split
from raygrid.emulator.processes.array import Array
from raygrid.emulator.simulator import simulator
from raygrid.host.cli.trace import trace_pixel
from raygrid.host.render.animation_jobs import jobs_of
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.render.program_file import read_program
from raygrid.host.scene.load import load_scene
from raygrid.node.jit.switches import NATIVE_LINKS
from raygrid.node.links.zmq_c_api import OLD_SWITCH
from raygrid.node.timed import timed_processor
from support import paths
from support.motions import holdings
from support.timed import Books, books_of, counted, emulated, job_of, scene_of, simulated

Facts = dict[str, Any]
SECONDS = 800  # for all cases, with compiling; only a failing test takes as long
SIZE = (6, 4)
BOTH_KINDS = (
    "kinds.nff",
    "glass.toml",
)  # every NFF primitive, smooth normals and mirrors; glass and lights that are seen
TIMED = (("kinds.nff", "t800", "list"), ("glass.toml", "8086", "tree"))  # scene, costs, how hits are searched for
COUNTED = ("born", "died", "walks", "hits", "tests", "boxes")


def digest(*arrays: NDArray[Any]) -> str:
    """Types, shapes and bits of arrays, in a few letters."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(f"{array.dtype.str} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:16]


def in_memory(job: Job, **options: Any) -> Facts:
    """The picture of an array in memory, and what each of its nodes counted."""
    array = MemoryArray(job.space.shape, **options)
    array.driver.patience = SECONDS
    array.driver.ready()
    return _told(render_job(array.driver, job))


def _told(picture: Any) -> Facts:
    nodes = [{name: node[name] for name in COUNTED} for node in picture.stats["nodes"]]
    return {"sums": digest(picture.sums), "nodes": nodes}


def _books(books: Books) -> Facts:
    columns = {name: value.tolist() for name, value in books._asdict().items() if isinstance(value, np.ndarray)}
    return {**columns, "ticks": books.ticks, "trace": books.trace, "sums": digest(books.sums)}


# --- cases -------------------------------------------------------------------------------------------------


def pictures() -> Facts:
    """Every kind of surface, material and light, on arrays of two shapes."""
    facts = {}
    for name in BOTH_KINDS:
        whole, parts = (in_memory(job_of(name, shape, SIZE, samples=1)) for shape in ((1, 1, 1), (2, 2, 1)))
        single = in_memory(job_of(name, (2, 1, 1), SIZE, samples=1), batch=1)
        assert whole["sums"] == parts["sums"] == single["sums"]
        facts[name] = [whole, parts, single]
    facts["beside the world box"] = in_memory(wide_job())
    return facts


def wide_job() -> Job:
    """A frame of which most rays miss the world box."""
    return make_job(scene_of("tiny.nff"), (2, 1, 1), Settings(size=(40, 5), samples=1))


def balanced() -> Facts:
    """A split by a sampling pre-pass: its planes, and the picture that must not depend on them."""
    with mock.patch.object(split, "WORTHWHILE", 0):
        job = job_of("glass.toml", (2, 2, 2), SIZE, "balanced", samples=1)
    return {"planes": job.space.planes.tolist(), **in_memory(job)}


def machine_time() -> Facts:
    """A frame by nodes that keep machine time: links that move bytes by themselves, and processors that do it."""
    facts = {}
    for (name, cost, search), batch in zip(TIMED, (1024, 1), strict=True):
        with mock.patch.object(timed_processor, "FIRST_CLOCK_ROOM", 8):  # it must grow
            books = emulated(job_of(name, (2, 2, 1), SIZE, samples=1), cost, search, batch=batch)
        facts[f"{name} {cost}"] = _books(books)
    return facts


def simulation() -> Facts:
    """The same frames by the simulator, with set-up and read-out: the books must be those of the nodes."""
    facts = {}
    for name, cost, search in TIMED:
        with mock.patch.multiple(simulator, FIRST_ROOM=16, TURN_EVENTS=100):  # it must grow, and come back between
            done = simulated(job_of(name, (2, 2, 1), SIZE, samples=1), cost, search, around=True)
        phases = {"frame": done.frames["middle"], "read-out": done.read_outs["middle"]}
        facts[f"{name} {cost}"] = _books(books_of(done)) | {
            "flood": [done.floods["middle"].ticks, done.floods["middle"].visits],
            **{
                of: [phase.ticks, phase.host, phase.events, phase.total.tolist(), digest(phase.hops, phase.levels)]
                for of, phase in phases.items()
            },
        }
    return facts


def work_count() -> Facts:
    """What each cell would do for a frame, by two price lists."""
    return {"inside": _work_of(job_of("kinds.nff", (2, 1, 2), SIZE, samples=1)), "beside": _work_of(wide_job())}


def _work_of(job: Job) -> Facts:
    work = counted(job.space, job.surfaces, job.frame, "list", ("8086", "t800")).work
    return {name: _plain(getattr(work, name)) for name in ("busy", "sent", "born", "longest", "counts", "steps")}


def deadlock() -> Facts:
    """The naive machine, which jams with room for one packet a buffer."""
    job = job_of("tiny.nff", (2, 2, 2), (8, 8), samples=1)
    outcome = NaiveMachine(job.space, job.surfaces, job.frame, 1).run()
    assert outcome.jammed
    return dataclasses.asdict(outcome)


def provenance() -> Facts:
    """The ray trees of pixels: a glass ball, the sky beside the world box."""
    job = job_of("glass.toml", (2, 1, 1), (12, 7), samples=2)
    return {"ball": trace_pixel(job, 6, 4), "sky": trace_pixel(wide_job(), 0, 2)}


def movement() -> Facts:
    """Frames of a shot by increments: what every node holds after each, and the pictures."""
    scene = load_scene(paths.SCENES / "mobile.toml")
    array = MemoryArray((2, 1, 2))
    array.driver.patience = SECONDS
    array.driver.ready()
    facts = {}
    for job in jobs_of(scene, (2, 1, 2), Settings(size=SIZE, samples=1, split="uniform"), [1, 2, 30]):
        facts[f"frame {job.number}"] = _told(render_job(array.driver, job)) | {"held": _plain(holdings(array))}
    return facts


def profile() -> Facts:
    """A profiled frame, of which parts are traced once more aside: nothing of that shows."""
    job = job_of("kinds.nff", (2, 1, 1), (12, 10), samples=1)
    facts = in_memory(job, profile=True)
    assert facts == in_memory(job)
    return facts


def program() -> Facts:
    """Surfaces and a colour of a program."""
    facts = {}
    for scene, name in (("rings.toml", "torus"), ("marble.toml", "marble")):
        chosen = read_program(paths.SCENES / "programs" / f"{name}.py")
        facts[name] = in_memory(job_of(scene, (2, 1, 1), SIZE, samples=1, program=chosen), programs=True)
    return facts


def processes() -> Facts:
    """Real processes with native links, of which each node is a loop in compiled code, or interpreted."""
    with mock.patch.dict(os.environ, {NATIVE_LINKS.variable: "1"}):  # also where the tests run without
        os.environ.pop(OLD_SWITCH, None)
        with Array.launch((2, 1, 1), patience=SECONDS) as array:
            picture = render_job(array.driver, job_of("kinds.nff", (2, 1, 1), SIZE, samples=1))
    assert [node["served_by"] for node in picture.stats["nodes"]] == ["compiled"] * 2
    return _told(picture)


def _plain(value: Any) -> Any:
    """Arrays and bytes as what JSON can carry."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, bytes):
        return hashlib.sha256(value).hexdigest()[:16]
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


# --- both kinds of kernels ---------------------------------------------------------------------------------

CASES: dict[str, Callable[[], Facts]] = {
    case.__name__: case
    for case in (
        pictures,
        balanced,
        machine_time,
        simulation,
        work_count,
        deadlock,
        provenance,
        movement,
        profile,
        program,
        processes,
    )
}


def facts_of(case: str) -> Facts:
    """The facts of a case as JSON gives them back."""
    found: Facts = json.loads(json.dumps(CASES[case]()))
    return found


def facts_of_the_others() -> dict[str, Facts]:
    """The facts of all cases, of a process whose kernels are interpreted where these are compiled, and the other way round."""
    other = "0" if numba.config.DISABLE_JIT else "1"
    done = subprocess.run(
        [sys.executable, "-W", "ignore::RuntimeWarning", "-m", "support.twins"],
        cwd=paths.ROOT / "tests",
        env=os.environ | {"NUMBA_DISABLE_JIT": other},
        capture_output=True,
        text=True,
        timeout=SECONDS,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["interpreted"] == bool(int(other))
    facts: dict[str, Facts] = told["facts"]
    return facts


if __name__ == "__main__":
    every = {case: facts_of(case) for case in CASES}
    json.dump({"interpreted": bool(numba.config.DISABLE_JIT), "facts": every}, sys.stdout)
