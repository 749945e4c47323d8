"""Damaged caches of compiled kernels for the fault campaign: a command must compile anew what is damaged, and be right.

A copy of the cache is damaged, and a frame rendered with it twice, for what was made anew is kept.
"""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

from faults_bed import Case, Outcome
from faults_service import SAMPLES, SHAPE, SIZE, TINY, Wrong, command, one_line, right

from raygrid.node.jit import cache

ROOT = Path(__file__).parents[1]
FILES = 3  # that are damaged at once
SECONDS = 110.0


class CacheBed:
    """Commands with a cache of their own. Use as a context manager."""

    def __init__(self, folder: Path) -> None:
        self.root, self.folder = folder, folder / "cached"
        self.cache = folder / "cache"
        self._read: set[Path] = set()

    def run(self, case: Case) -> Outcome:
        """One case with a whole cache, which it damages."""
        self._whole()
        try:
            return case.do(self)
        except Wrong as error:
            return Outcome("wrong", str(error))
        except Exception as error:  # of the harness, or a command that took too long
            return Outcome("wrong", f"{type(error).__name__}: {error}")

    def files(self) -> list[Path]:
        """The files of the cache that are read for a frame, or all; in an order that does not depend on the disk."""
        found = sorted(path for path in self.cache.rglob("*") if path.is_file())
        return [path for path in found if path.relative_to(self.cache) in self._read] or found

    def _find_read(self) -> None:
        """See which files a frame reads, by their times of access, where the disk keeps those."""
        self._whole()
        found = [path for path in self.cache.rglob("*") if path.is_file()]
        for path in found:
            os.utime(path, (0.0, path.stat().st_mtime))  # so old that the next access is noted
        render_twice(self)
        self._read = {path.relative_to(self.cache) for path in found if path.exists() and path.stat().st_atime > 0.0}

    def _whole(self) -> None:
        """Have a whole cache, and no outputs."""
        for folder in (self.folder, self.cache):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(mode=0o700)
        copy_cache(self.cache)

    def renew(self) -> None:
        """Nothing lasts from one case to the next."""

    def left(self) -> list[str]:
        """Parts of files beside the outputs."""
        return [str(path) for path in self.folder.rglob(".raygrid*")]

    def __enter__(self) -> Self:
        self._find_read()
        print(f"{len(self._read) or 'no'} files of the cache were seen to be read for a frame", flush=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        shutil.rmtree(self.cache, ignore_errors=True)


def copy_cache(to: Path) -> None:
    """Copy the kernels of this state of the sources, and of this place of them only if it has a directory by its name."""
    if cache.DIRECTORY is None:
        raise Wrong("there is no cache to damage")
    source = Path(cache.DIRECTORY)
    ours = _of_this_place(source)
    for folder in source.iterdir():
        if folder.is_dir() and (not ours or folder in ours or folder.name.startswith("program-")):
            shutil.copytree(folder, to / source.name / folder.name, symlinks=True)
        elif folder.is_file():
            shutil.copy2(folder, to / source.name / folder.name)
    (to / source.name).chmod(0o700)


def _of_this_place(source: Path) -> list[Path]:
    from numba.core import caching

    locator = getattr(caching, "_CacheLocator", None) or getattr(caching, "_SourceFileBackedLocatorMixin", None)
    name = getattr(locator, "get_suitable_cache_subpath", None)
    if name is None:
        return []
    found = [source / name(str(ROOT / package / "main.py")) for package in ("node", "emulator", "host")]
    return [folder for folder in found if folder.is_dir()]


def render_twice(bed: CacheBed, **more: str) -> None:
    """A frame, and again with what the first run has kept. Raises Wrong."""
    environment = os.environ | {"RAYGRID_CACHE": str(bed.cache)} | more
    environment.pop("NUMBA_CACHE_DIR", None)
    size, shape = "x".join(map(str, SIZE)), "x".join(map(str, SHAPE))
    options = ["--array", shape, "--size", size, "--samples", str(SAMPLES), "--quiet"]
    for name in ("a.npy", "b.npy"):
        file = bed.folder / name
        done = command("render", str(TINY), *options, "-o", str(file), seconds=SECONDS, env=environment)
        if done.returncode != 0:
            raise Wrong(f"{name}: exit code {done.returncode}: {one_line(done.stderr)}")
        right(file)


Damage = Callable[[Path, random.Random], None]


def _flip(path: Path, rng: random.Random) -> None:
    data = bytearray(path.read_bytes())
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(data)


def _truncate(path: Path, rng: random.Random) -> None:
    os.truncate(path, rng.randrange(max(1, path.stat().st_size)))


def _empty(path: Path, rng: random.Random) -> None:
    path.write_bytes(b"")


def _zero(path: Path, rng: random.Random) -> None:
    path.write_bytes(bytes(path.stat().st_size))


def _garbage(path: Path, rng: random.Random) -> None:
    path.write_bytes(rng.randbytes(path.stat().st_size))


def _longer(path: Path, rng: random.Random) -> None:
    with path.open("ab") as file:
        file.write(rng.randbytes(rng.randrange(1, 5000)))


def _gone(path: Path, rng: random.Random) -> None:
    path.unlink()


def _directory(path: Path, rng: random.Random) -> None:
    path.unlink()
    path.mkdir()


def _dangling(path: Path, rng: random.Random) -> None:
    path.unlink()
    path.symlink_to(path.with_name("none"))


def _fifo(path: Path, rng: random.Random) -> None:
    path.unlink()
    os.mkfifo(path)


DAMAGE: tuple[Damage, ...] = (_flip, _flip, _flip, _truncate, _empty, _zero, _garbage, _longer, _gone)
STRANGE: tuple[Damage, ...] = (_directory, _dangling, _fifo)


def _damaged(kinds: tuple[Damage, ...], files: int) -> Callable[[random.Random], list[Case]]:
    """Some files are damaged, each in the same way."""

    def do(bed: CacheBed, damage: Damage, seed: int) -> Outcome:
        rng = random.Random(seed)
        found = bed.files()
        for path in rng.sample(found, min(files, len(found))):
            damage(path, rng)
        render_twice(bed)
        return Outcome("same", ready=(0.0,))

    def cases(rng: random.Random) -> list[Case]:
        found = []
        for damage in kinds:
            seed = rng.getrandbits(32)
            name = f"{files} files: {damage.__name__.strip('_')} {seed}"
            found.append(Case(name, partial(do, damage=damage, seed=seed)))
        return found

    return cases


def _swapped(rng: random.Random) -> list[Case]:
    """The contents of one kernel's file in another's."""

    def do(bed: CacheBed, seed: int) -> Outcome:
        own = random.Random(seed)
        code = [path for path in bed.files() if path.suffix == ".nbc"]
        for one, other in zip(own.sample(code, FILES), own.sample(code, FILES), strict=True):
            one.write_bytes(other.read_bytes())
        render_twice(bed)
        return Outcome("same", ready=(0.0,))

    seed = rng.getrandbits(32)
    return [Case(f"contents of other kernels {seed}", partial(do, seed=seed))]


GROUPS = {
    "kernel cache damaged": _damaged(DAMAGE, FILES),
    "kernel cache with what is no file": _damaged(STRANGE, 3),
    "kernel cache with other kernels' code": _swapped,
}
