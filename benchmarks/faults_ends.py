"""Faults of the front end's surroundings for the campaign: disks, directories, descriptors, and the front end's own end."""

from __future__ import annotations

import os
import random
import resource
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from faults_bed import BUDGET, SCENE, SETTINGS, Bed, Case, Outcome, judge, render, right, text_of

from raygrid.node.errors import OutputError, RaygridError

FRONT_END = """
import sys
from raygrid.host.render.api import launch
shape, scene, moment, nth, *numbers = sys.argv[1:]
seen = 0
def tell():
    print("now", flush=True)
    sys.stdin.readline()
with launch(shape) as machine:
    def watch(phase, progress):
        global seen
        seen += phase == "trace" and progress is not None
        if phase == moment and (phase != "trace" or seen == int(nth)):
            tell()
    print(*machine.pids, machine._array._fork_server.pid, machine._array._place.path, flush=True)
    if moment == "idle":
        tell()
    width, height, samples, budget = map(int, numbers)
    machine.render(scene, budget=budget, size=(width, height), samples=samples, watch=watch)
"""


def _front_end(rng: random.Random) -> list[Case]:
    """The front end is killed: all its processes end by themselves, and its files are removed."""

    def do(bed: Bed, moment: str, nth: int) -> Outcome:
        numbers = [*SETTINGS.size, SETTINGS.samples, BUDGET]
        command = [
            sys.executable,
            "-c",
            FRONT_END,
            text_of(bed.shape),
            str(SCENE),
            moment,
            str(nth),
            *map(str, numbers),
        ]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as front_end:
            assert front_end.stdout is not None
            *pids, place = front_end.stdout.readline().split()
            front_end.stdout.readline()
            front_end.kill()
            begun = time.perf_counter()
            gone = all(_ends(int(pid)) for pid in pids) and not os.path.exists(place)
        seconds = time.perf_counter() - begun
        return Outcome("same", ready=(seconds,)) if gone else Outcome("wrong", "processes or files were left")

    moments = [(moment, 1) for moment in ("idle", "load", "collect")] + [("trace", rng.randint(1, 4))]
    return [
        Case(f"front end killed at {moment}", lambda bed, moment=moment, nth=nth: do(bed, moment, nth))
        for moment, nth in moments
    ]


def _ends(pid: int) -> bool:
    """Whether a process ends within 10 seconds."""
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([descriptor], [], [], 10.0)[0])
    finally:
        os.close(descriptor)


def _full_disk(rng: random.Random) -> list[Case]:
    """The picture has no room: as a limit on the size of files, in a front end of its own."""

    def do(bed: Bed) -> Outcome:
        folder = bed.folder / "full"
        folder.mkdir(exist_ok=True)
        size = "x".join(map(str, SETTINGS.size))
        command = [str(Path(sys.executable).with_name("raygrid")), "render", str(SCENE), "--array", text_of(bed.shape)]
        command += ["--size", size, "-o", "x.npy", "--quiet"]
        most = rng.choice((100, 5000, 60_000))

        def limit() -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

        done = subprocess.run(command, cwd=folder, preexec_fn=limit, capture_output=True, text=True, timeout=100)
        left = list(folder.iterdir())
        if done.returncode != 1 or done.stderr.count("\n") != 1 or left:
            return Outcome("wrong", f"exit code {done.returncode}, {left}: {done.stderr}")
        return Outcome("refused", done.stderr.strip())

    return [Case("disk full", do)]


def _gone_directory(rng: random.Random) -> list[Case]:
    """The output directory is removed while the frame is traced; saved elsewhere, the picture is right."""

    def do(bed: Bed) -> Outcome:
        folder = bed.folder / "gone"
        folder.mkdir()

        def watch(phase: str, progress: object) -> None:
            if phase == "trace":
                shutil.rmtree(folder, ignore_errors=True)

        picture = render(bed.array, watch=watch)
        try:
            picture.save(folder / "x.npy")
        except OutputError:
            return judge(lambda: picture, bed)
        return Outcome("wrong", "a file was written into a directory that is gone")

    return [Case("output directory gone", do)]


def _few_descriptors(rng: random.Random) -> list[Case]:
    """This process can open none while a lost node is forked anew; afterwards it can again."""

    def do(bed: Bed) -> Outcome:
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        os.kill(rng.choice(bed.array.pids), signal.SIGKILL)
        used = len(os.listdir("/proc/self/fd"))
        resource.setrlimit(resource.RLIMIT_NOFILE, (used + rng.randrange(3), hard))
        try:
            outcome = Outcome("same" if right(render(bed.array), bed.shape) else "wrong", "other bits")
        except RaygridError as error:
            outcome = Outcome("refused", str(error))
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        if outcome.what == "refused":
            bed.array.reset()
        return outcome

    return [Case("descriptors of the host used up", do)]


GROUPS = {
    "front end killed": _front_end,
    "disk full": _full_disk,
    "output directory gone": _gone_directory,
    "descriptors of the host used up": _few_descriptors,
}
