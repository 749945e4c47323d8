"""Another user of the same computer, for the fault campaign: must get into nothing of ours, and plant nothing that we run.

Needs root: a child of this process becomes another user (65534, nobody) and tries. What it tries is told by what it returns:
nothing if it was kept out, else what it got.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import random
import shutil
import signal
import socket
import stat
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from faults_bed import Case, Outcome
from faults_cache import copy_cache
from faults_service import NAME, SAMPLES, SIZE, TINY, ServiceBed, Wrong, command, one_line, right, submit

import raygrid
from raygrid.emulator.topology import socket_directory
from raygrid.host.client.service_files import JOURNAL, LOCK, LOG, RECORD, SOCKET, TOKEN, state_directory
from raygrid.node.jit import cache as kernel_cache

NOBODY = 65534
Try = Callable[[], str]  # what was got; "" for nothing


def cannot() -> str:
    """Why these cases cannot be tried here."""
    return "" if os.geteuid() == 0 else "it takes root to become another user"


def as_nobody(attempt: Try) -> str:
    """Run something as another user in a child; returns what it got."""
    reading, writing = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reading)
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
            try:
                got = attempt()
            except OSError:
                got = ""
            os.write(writing, json.dumps(got)[:4000].encode())
        finally:
            os._exit(0)
    os.close(writing)
    with open(reading, "rb") as file:
        said = file.read()
    os.waitpid(pid, 0)
    if not said:
        raise Wrong("the other user's process said nothing")
    return str(json.loads(said))


# --- what it tries ----------------------------------------------------------------------------------


def _connect(path: Path) -> str:
    with socket.socket(socket.AF_UNIX) as peer:
        peer.connect(str(path))
    return f"connected to {path}"


def _list(path: Path) -> str:
    return f"listed {path}: {os.listdir(path)[:5]}"


def _read(path: Path) -> str:
    return f"read {len(path.read_bytes())} bytes of {path}"


def _write(path: Path) -> str:
    with path.open("ab") as file:
        file.write(b"x")
    return f"wrote to {path}"


def _make(path: Path) -> str:
    (path / "planted").touch()
    return f"made a file in {path}"


def _remove(path: Path) -> str:
    path.unlink()
    return f"removed {path}"


def _lock(path: Path) -> str:
    import fcntl

    with path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return f"locked {path}"


def _signal(pid: int) -> str:
    os.kill(pid, signal.SIGKILL)
    return f"killed {pid}"


def _memory(pid: int) -> str:
    with open(f"/proc/{pid}/mem", "rb") as file:
        file.seek(1 << 22)
        file.read(1)
    return f"read the memory of {pid}"


def _environment(pid: int) -> str:
    return f"read {len(Path(f'/proc/{pid}/environ').read_bytes())} bytes of the environment of {pid}"


def _open_files(pid: int) -> str:
    found = os.listdir(f"/proc/{pid}/fd")
    return f"saw {len(found)} descriptors of {pid}"


def _tries(bed: ServiceBed) -> dict[str, list[Try]]:
    door, state = Path(bed.record.directory), state_directory(NAME)
    with raygrid.connect(NAME) as array:
        pids = [array.pid, *(node["pid"] for node in array.status()["nodes"])]
    arrays = [
        folder for base in map(Path, socket_directory.bases()) for folder in base.glob(f"{socket_directory.PREFIX}*")
    ]
    ours = [folder for folder in arrays if str(folder).startswith(str(bed.root))]
    sockets = [path for folder in ours for path in folder.iterdir() if stat.S_ISSOCK(path.lstat().st_mode)]
    files = [door / TOKEN, *(state / name for name in (JOURNAL, LOG, LOCK, RECORD)), *state.glob("journal*")]
    cache = Path(kernel_cache.DIRECTORY or "/nonexistent")
    kept = [path for path in cache.rglob("*") if path.is_file()][:200]
    return {
        "to connect to a socket": [partial(_connect, path) for path in (door / SOCKET, *sockets)],
        "to list a directory": [partial(_list, path) for path in (door, state, *ours)],
        "to read a file": [partial(_read, path) for path in files],
        "to write to a file": [partial(_write, path) for path in (*files, *kept)],
        "to plant a file": [partial(_make, path) for path in (door, state, state.parent, *ours, cache)],
        "to remove a file": [partial(_remove, path) for path in (door / SOCKET, *files, *sockets, *kept)],
        "to hold the lock": [partial(_lock, state / LOCK)],
        "to signal a process": [partial(_signal, pid) for pid in pids],
        "to look into a process": [partial(look, pid) for pid in pids for look in (_memory, _environment, _open_files)],
    }


WAYS = (
    *("to connect to a socket", "to list a directory", "to read a file", "to write to a file", "to plant a file"),
    *("to remove a file", "to hold the lock", "to signal a process", "to look into a process"),
)


def _kept_out(rng: random.Random) -> list[Case]:
    """Whatever it tries while the service is up, it gets nothing."""

    def do(bed: ServiceBed, way: str, seed: int) -> Outcome:
        _open_up(bed)
        tries = _tries(bed)[way]
        (bed.root / "open to all").write_text("x")
        if not as_nobody(partial(_read, bed.root / "open to all")):  # or what follows would prove nothing
            raise Wrong("another user cannot read what is open to all")
        for attempt in random.Random(seed).sample(tries, min(12, len(tries))):
            got = as_nobody(attempt)
            if got:
                raise Wrong(f"another user {got}")
        return Outcome("same", ready=(0.0,))

    return [Case(way, partial(do, way=way, seed=rng.getrandbits(32))) for way in WAYS]


def _open_up(bed: ServiceBed) -> None:
    """The directories above ours let everybody through: what keeps another user out is what raygrid makes."""
    for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME"):
        os.chmod(os.environ[name], 0o755)
    os.chmod(os.environ["TMPDIR"], 0o1777)
    bed.root.chmod(0o755)


# --- what it plants ---------------------------------------------------------------------------------


class Planted:
    """Runs a command when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, (f"touch {self.mark}",)


def _shared(bed: ServiceBed, mode: int) -> Path:
    """A directory for caches that all may write to."""
    shared = bed.root / "shared"
    shutil.rmtree(shared, ignore_errors=True)
    shared.mkdir()
    shared.chmod(mode)
    return shared


def _plant(shared: Path, mark: Path, whole: Path, how: str) -> str:
    """As the other user: our cache's files, each with a pickle in it that tells if it is loaded."""
    target = shared / whole.name
    real = target if how != "link" else shared / "elsewhere"
    evil = pickle.dumps(Planted(mark))
    for path in whole.rglob("*"):
        to = real / path.relative_to(whole)
        if path.is_dir():
            to.mkdir(parents=True, exist_ok=True)
        else:
            to.parent.mkdir(parents=True, exist_ok=True)
            data = path.read_bytes()
            to.write_bytes(data if how == "code" and path.suffix != ".nbc" else evil)
    if how == "link":
        target.symlink_to(real)
    for folder in (real, *real.rglob("*")):
        folder.chmod(0o777)
    return ""


def _planted(rng: random.Random) -> list[Case]:
    """It makes the directory of our digest in a shared place before us: nothing of it is run, and the picture is right."""

    def do(bed: ServiceBed, how: str, mode: int) -> Outcome:
        _open_up(bed)
        shared, mark = _shared(bed, mode), bed.root / "tmp" / "planted"
        whole = bed.root / "whole"
        bed.empty(whole)
        copy_cache(whole)
        source = whole / Path(kernel_cache.DIRECTORY or "none").name
        for path in (whole, *whole.rglob("*")):
            path.chmod(0o755)
        as_nobody(lambda: _plant(shared, mark, source, how))
        if not (shared / source.name).is_dir():
            raise Wrong("nothing was planted")
        environment = os.environ | {"RAYGRID_CACHE": str(shared)}
        size = "x".join(map(str, SIZE))
        options = ["--array", "2x1x1", "--size", size, "--samples", str(SAMPLES), "--quiet"]
        done = command("render", str(TINY), *options, "-o", str(bed.folder / "a.npy"), seconds=110.0, env=environment)
        run = mark.exists()
        mark.unlink(missing_ok=True)
        shutil.rmtree(whole)
        shutil.rmtree(shared)
        if run:
            raise Wrong("a pickle of another user was run as us")
        if done.returncode != 0:
            return Outcome("refused", one_line(done.stderr))
        right(bed.folder / "a.npy")
        return Outcome("same", ready=(0.0,))

    ways = [("pickle", 0o1777), ("code", 0o1777), ("link", 0o1777), ("pickle", 0o777)]
    return [Case(f"{how}, mode {mode:o}", partial(do, how=how, mode=mode)) for how, mode in rng.sample(ways, 2)]


def _masks(rng: random.Random) -> list[Case]:
    """Whatever the mask of the one who launches, nobody else may write to, or read, what raygrid makes."""

    def do(bed: ServiceBed, mask: int) -> Outcome:
        bed.down()
        shutil.rmtree(state_directory(NAME).parent, ignore_errors=True)
        before = os.umask(mask)
        try:
            bed.bring_up()
        finally:
            os.umask(before)
        with raygrid.connect(NAME) as array:
            submit(array, bed.folder / "a.npy").wait()
        right(bed.folder / "a.npy")
        state, door = state_directory(NAME), Path(bed.record.directory)
        open_to_others = []
        for path in (state.parent, state, *state.iterdir(), door, *door.iterdir()):
            with contextlib.suppress(OSError):
                if path.lstat().st_mode & 0o077 and not path.is_symlink():
                    open_to_others.append(f"{path} ({path.lstat().st_mode & 0o777:o})")
        private = [what for what in open_to_others if Path(what.split(" (")[0]).parent not in (state, door)]
        writable = [path for path in (*state.iterdir(), *door.iterdir()) if path.lstat().st_mode & 0o022]
        if private or writable:
            raise Wrong(f"with umask {mask:o} these are open to others: {private + writable}")
        return Outcome("same", ready=(0.0,))

    return [Case(f"umask {mask:o}", partial(do, mask=mask)) for mask in (0, rng.choice((0o002, 0o022, 0o777 & 0o707)))]


GROUPS = {
    "another user tries": _kept_out,
    "another user plants a cache": _planted,
    "a mask that is open": _masks,
}
