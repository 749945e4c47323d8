"""Giving up for the fault campaign: cancel, reset and down while a scene is read, split and loaded.

A large scene takes seconds for each of these; whatever is under way when the word comes, the next client's frame must not wait
for it, and nothing of it may be seen in that frame.
"""

from __future__ import annotations

import contextlib
import random
import time
from functools import partial
from pathlib import Path

from faults_bed import Case, Outcome
from faults_service import NAME, ServiceBed, Wrong, right, submit, wait_until

import raygrid
from raygrid.host.client.client import Service
from raygrid.node.errors import RaygridError

POLYGONS = 400_000
SPAN = 8.0  # seconds in which the large scene is read, split, loaded and traced, on a quiet computer
PROMPT = 3.0  # seconds for the next client's frame, on a computer that does other things as well
LARGE = {"size": (800, 600), "samples": 2}  # so many rays that the balanced split looks at them


def _large(bed: ServiceBed) -> Path:
    """A scene of tens of megabytes, the same for all cases."""
    path = bed.root / "large.nff"
    if not path.exists():
        rng = random.Random(7)
        lines = [
            "v from 0 0 9 at 0 0 0 up 0 1 0 angle 40 hither 1 resolution 64 48",
            "l 2 4 9",
            "f 1 0.5 0.5 0.9 0.1 5 0 1",
        ]
        for _ in range(POLYGONS):
            x, y, z = (rng.uniform(-2.0, 2.0) for _ in range(3))
            lines.append(f"p 3 {x:.6f} {y:.6f} {z:.6f} {x + 0.02:.6f} {y:.6f} {z:.6f} {x:.6f} {y + 0.02:.6f} {z:.6f}")
        path.write_text("\n".join(lines) + "\n")
    return path


def _begun(array: Service, job: int) -> bool:
    running = array.status()["running"]
    return running is not None and running["job"] == job


def _given_up(rng: random.Random) -> list[Case]:
    def do(bed: ServiceBed, after: float, how: str) -> Outcome:
        with raygrid.connect(NAME) as array, raygrid.connect(NAME) as other:
            job = submit(array, bed.folder / "large.npy", _large(bed), **LARGE)
            wait_until(lambda: _begun(array, job.job), 10.0, "the beginning of the job")
            time.sleep(after)
            begun = time.perf_counter()
            if how == "reset":
                array.reset()
            job.cancel()
            submit(other, bed.folder / "next.npy").wait()
            seconds = time.perf_counter() - begun
            with contextlib.suppress(RaygridError):
                job.wait()
        right(bed.folder / "next.npy")
        if seconds > PROMPT:
            raise Wrong(f"the next client's frame came {seconds:.1f} s after, wanted at most {PROMPT:g}")
        return Outcome("same", ready=(seconds,))

    return [
        Case(f"{how} after {after:.2f} s", partial(do, after=after, how=how))
        for after, how in ((rng.uniform(0.0, SPAN), how) for how in ("cancel", "cancel", "cancel", "reset"))
    ]


def _down(rng: random.Random) -> list[Case]:
    """Taken down while the scene is read, split or loaded; the job goes on when it is up again, and is cancelled then."""

    def do(bed: ServiceBed, after: float) -> Outcome:
        with raygrid.connect(NAME) as array:
            job = submit(array, bed.folder / "large.npy", _large(bed), **LARGE)
            wait_until(lambda: _begun(array, job.job), 10.0, "the beginning of the job")
            time.sleep(after)
            begun = time.perf_counter()
            array.down()
            seconds = time.perf_counter() - begun
        bed.bring_up()
        with raygrid.connect(NAME) as array:
            state = next((facts["state"] for facts in array.jobs(1000) if facts["job"] == job.job), "lost")
            whole = (bed.folder / "large.npy").is_file()
            if state not in ("queued", "running") and not (state == "done" and whole):  # done: before it was taken down
                raise Wrong(f"the job is {state}, its file is {'there' if whole else 'not there'}")
            array.cancel(None)
        if seconds > PROMPT:
            raise Wrong(f"down took {seconds:.1f} s, wanted at most {PROMPT:g}")
        return Outcome("same", ready=(seconds,))

    return [
        Case(f"down after {after:.2f} s", partial(do, after=after))
        for after in (rng.uniform(0.0, SPAN / 2), rng.uniform(0.0, SPAN))
    ]


GROUPS = {
    "cancelled while reading, splitting, loading": _given_up,
    "taken down while reading, splitting, loading": _down,
}
