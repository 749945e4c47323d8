"""Finds out how raygrid stands on this computer: versions, fast paths, the kernel cache, limits, places for files.

It only looks: nothing is launched or compiled, and nothing is left behind. What decides is asked itself (`node.links`,
`node.jit`, `emulator.topology`), so that what is said here is what an array would meet.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import operator
import os
import platform
import re
import sys
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import TypedDict

from raygrid.emulator.processes import ANALYSIS, KINDS, SIMULATOR
from raygrid.emulator.topology import (
    UNLIMITED,
    Bound,
    Resources,
    check_fits,
    largest_that_fits,
    read_resources,
    why_not_usable,
)
from raygrid.host.image.ffmpeg import find_ffmpeg
from raygrid.host.text.clean_text import printable
from raygrid.node.errors import TooLarge

SMALL = (2, 2, 2)  # the array that `render` launches unless told otherwise
NEEDED = (  # distributions that raygrid does not run without, by their usual names
    *(
        "numpy",
        "numba",
        "llvmlite",
        "pyzmq",
        "msgpack",
        "xxhash",
        "Pillow",
        "trimesh",
        "plyfile",
        "mapbox-earcut",
        "click",
    ),
    *("rich", "pydantic"),
)
IMPORTED = {"numpy": "numpy", "numba": "numba", "zmq": "pyzmq", "msgpack": "msgpack", "xxhash": "xxhash"}  # by nodes
EXTRAS = {
    "plots": ("matplotlib",),
    "law": ("matplotlib", "scipy"),
    "prometheus": ("prometheus_client",),
    "exr": ("openexr",),
    "mp4": ("imageio-ffmpeg",),
}
# package of a kernel -> the kind of kernels to which it belongs, where that is not the first
KIND_OF_PACKAGE = {"timed": KINDS[1], "simulator": SIMULATOR, "analysis": ANALYSIS}
HELPS = {  # resource -> what helps if there is too little of it
    "descriptors": "raise it by ulimit -n 4096 before",
    "all_files": "end what holds files open, or raise it by sysctl",
    "tasks": "end other processes, or raise it",
    "memory": "end what takes it, or give the container more",
}
VARIABLES = ("XDG_RUNTIME_DIR", "XDG_CACHE_HOME", "XDG_STATE_HOME", "TMPDIR")  # and all of raygrid and numba


class FastPath(TypedDict):
    """A faster way of doing the same; why: why it is off, None if it is on."""

    on: bool
    what: str
    why: str | None


class CacheFacts(TypedDict):
    """Where compiled kernels are kept.

    directory  None: nowhere
    exists     whether it is there; else the next run makes it
    why        what is wrong with the places that come before it, "" if it is the first
    bytes      of it; bytes_beside: of those of other states of the sources
    functions  kind of kernels -> compiled functions that are kept
    programs   compiled programs that are kept
    """

    directory: str | None
    exists: bool
    writable: bool
    why: str
    bytes: int
    bytes_beside: int
    functions: dict[str, int]
    programs: int


class LimitFacts(TypedDict):
    """What there is of something; left None: no limit. `largest` is the largest cube that fits if all else is there."""

    left: int | None
    limit: str
    largest: list[int]


class LocationFacts(TypedDict):
    """Directories; sockets: each in which they may be, best first -> what is wrong with it, None if nothing is."""

    sockets: dict[str, str | None]
    temporary: str | None
    ffmpeg: str | None


# --- versions ----------------------------------------------------------------------------------------


def read_versions() -> dict[str, str | None]:
    """Read the version of raygrid, of Python and of each library; None of one that is not installed."""
    versions = {"raygrid": _version("raygrid"), "Python": platform.python_version()}
    for name in NEEDED:
        versions[name] = _version(name)
        if name == "pyzmq":
            with contextlib.suppress(Exception):  # what is wrong with it `read_faults` says
                versions["libzmq"] = importlib.import_module("zmq").zmq_version()
    return versions


def read_system() -> str:
    """Name the operating system and the processor's family."""
    system = os.uname()
    return f"{system.sysname} {system.release} {system.machine}"


def read_extras() -> dict[str, dict[str, str | None]]:
    """Read the versions of the libraries of each extra; None of one that is not installed."""
    return {extra: {name: _version(name) for name in names} for extra, names in EXTRAS.items()}


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def read_misfits() -> dict[str, str]:
    """Read which libraries have versions that raygrid was not tried with; returns distribution -> what is wanted."""
    misfits = {}
    for wanted in metadata.requires("raygrid") or () if _version("raygrid") else ():
        found = re.fullmatch(r"([A-Za-z0-9_.-]+)((?:[<>]=?[0-9.]+,?)+)", wanted.replace(" ", ""))
        version = _version(found[1]) if found else None
        if found is not None and version is not None and not _fits(version, found[2]):
            misfits[found[1]] = found[2]
    return misfits


def _fits(version: str, bounds: str) -> bool:
    """Tell whether a version keeps bounds as of pyproject.toml, such as ">=1.2,<3"."""
    compare = {">=": operator.ge, "<": operator.lt, "<=": operator.le, ">": operator.gt}
    pairs = re.findall(r"([<>]=?)([0-9.]+)", bounds)
    return all(compare[sign](_release(version), _release(bound)) for sign, bound in pairs)


def _release(version: str) -> list[int]:
    """The numbers with which a version begins, without zeros at the end: a pre-release counts as what it comes before."""
    numbers = [int(number) for number in re.findall(r"\d+", re.match(r"[0-9.]*", version)[0])]  # type: ignore[index]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return numbers


def read_faults() -> dict[str, str]:
    """Import the libraries that nodes need; returns distribution -> why it cannot be imported."""
    faults = {}
    for module, name in IMPORTED.items():
        try:
            importlib.import_module(module)
        except Exception as error:  # a broken library may raise anything
            faults[name] = printable(f"{type(error).__name__}: {' '.join(str(error).split())}", 300)
    return faults


def read_environment() -> dict[str, str]:
    """Read the variables that are set and change what raygrid does."""
    wanted = [name for name in sorted(os.environ) if name.startswith(("RAYGRID_", "NUMBA_")) or name in VARIABLES]
    return {name: os.environ[name] for name in wanted}


# --- fast paths --------------------------------------------------------------------------------------


def read_fast_paths() -> dict[str, FastPath]:
    """Read which fast paths are on. The libraries that nodes need must be there."""
    from raygrid.node.links import why_python

    with only_looking():
        from raygrid.node.jit import fast_load, target
    asked = target.why_interpreted()
    return {
        "compiled kernels": _path("numba compiles them", asked),
        "native links": _path("compiled code calls ZeroMQ itself", why_python()),
        "fast kernel loading": _path("without waking the compiler", asked or fast_load.why_not_alone()),
        "vectors": _vectors(),
    }


def _path(what: str, why: str | None) -> FastPath:
    return {"on": why is None, "what": what, "why": why}


def _vectors() -> FastPath:
    """How wide the registers are in which eight rays are worked on at once."""
    from raygrid.node.jit import SIMD, why_off
    from raygrid.node.jit.target import read_target

    found = read_target()
    name = ", ".join(filter(None, (found.name, found.instructions)))
    return _path(f"eight rays at once, in registers of {found.bits} bits ({name})", why_off(SIMD) or found.why)


# --- kernel cache ------------------------------------------------------------------------------------


@contextlib.contextmanager
def only_looking() -> Iterator[None]:
    """Within, no directory is made, touched or removed: whoever tries is refused by an OSError.

    For the import of `node.jit.cache`, which makes its directory, and forgets those that nobody has used for long.
    """
    if "raygrid.node.jit.cache" in sys.modules:
        yield
        return
    refused = {"os.mkdir", "os.utime", "os.rmdir", "os.remove", "os.rename", "shutil.rmtree"}

    def refuse(event: str, _arguments: object) -> None:
        if event in refused:
            raise PermissionError(errno.EPERM, "here is only looked")

    sys.addaudithook(refuse)  # it cannot be taken away again, only made to refuse nothing
    try:
        yield
    finally:
        refused.clear()


def read_cache() -> CacheFacts:
    """Read where kernels are or would be kept, and what is kept there. The libraries that nodes need must be there."""
    with only_looking():
        from raygrid.node.jit import cache, why_not_trusted
    name = f"kernels-{cache.digest()}"
    wrong: list[str] = []
    for base in cache.bases():
        directory = Path(os.path.abspath(base)) / name
        exists = os.path.lexists(directory)
        why = why_not_trusted(str(directory)) if exists else _why_not_made(directory)
        if why is None:
            writable = not exists or os.access(directory, os.W_OK | os.X_OK, effective_ids=True)
            return _kept(directory, exists, writable, "; ".join(wrong))
        wrong.append(f"{directory}: {why}")
    return _kept(None, False, False, "; ".join(wrong))


def _why_not_made(directory: Path) -> str | None:
    """Why a directory that is not there cannot be made, or would not be trusted; None if it can."""
    from raygrid.node.jit import why_not_within

    nearest = os.path.realpath(next(path for path in directory.parents if os.path.lexists(path)))
    why = why_not_within(nearest)
    if why is None and not os.access(nearest, os.W_OK | os.X_OK, effective_ids=True):
        why = f"it is not there, and {nearest} cannot be written"
    return why


def _kept(directory: Path | None, exists: bool, writable: bool, why: str) -> CacheFacts:
    functions: dict[str, int] = {}
    programs = 0
    if directory is not None and exists:
        for folder, kind in _folders().items():
            functions[kind] = functions.get(kind, 0) + sum(1 for _ in directory.glob(f"{folder}/*.nbi"))
        programs = sum(1 for _ in directory.glob("program-*"))
    size = 0 if directory is None else _size(directory)
    beside = 0 if directory is None else sum(map(_size, directory.parent.glob("kernels-*"))) - size
    return {
        "directory": None if directory is None else str(directory),
        "exists": exists,
        "writable": writable,
        "why": why,
        "bytes": size,
        "bytes_beside": beside,
        "functions": {kind: functions[kind] for kind in KINDS if functions.get(kind)},
        "programs": programs,
    }


def _folders() -> dict[str, str]:
    """Folder of the cache -> kind of the kernels that it holds; a copy of raygrid that lies elsewhere has its own."""
    from raygrid.node.jit import fast_load, target

    if not fast_load.can_seal():  # nothing is kept then
        return {}
    layers = [Path(sys.modules[name].__path__[0]) for name in ("raygrid.node", "raygrid.emulator")]
    packages = [package for layer in layers for package in layer.iterdir()]
    return {
        target.kept_in(str(one / "x.py")): KIND_OF_PACKAGE.get(one.name, KINDS[0]) for one in packages if one.is_dir()
    }


def _size(directory: Path) -> int:
    """Bytes of all files below a directory; those that go meanwhile are left out."""
    size = 0
    for folder, _, names in os.walk(directory):
        for name in names:
            with contextlib.suppress(OSError):
                size += os.lstat(os.path.join(folder, name)).st_size
    return size


# --- limits and places -------------------------------------------------------------------------------


def read_limits() -> tuple[dict[str, LimitFacts], list[str]]:
    """Read what this computer has left, and what of it a small array lacks, a sentence each."""
    found = vars(read_resources())
    limits: dict[str, LimitFacts] = {}
    lacks = []
    for name, bound in found.items():
        alone = Resources(**{other: bound if other == name else Bound(UNLIMITED, "no limit") for other in found})
        left = None if bound.left >= UNLIMITED else max(bound.left, 0)
        limits[name] = {"left": left, "limit": bound.limit, "largest": list(largest_that_fits(alone))}
        try:
            check_fits(SMALL, resources=alone)
        except TooLarge as error:
            lacks.append(f"{error}: {HELPS[name]}")
    return limits, lacks


def read_places() -> LocationFacts:
    """Read where sockets and temporary files go, and where ffmpeg is."""
    temporary = None
    with contextlib.suppress(FileNotFoundError):  # Python has tried, and found no directory that can be written
        temporary = tempfile.gettempdir()
    return {"sockets": why_not_usable(SMALL), "temporary": temporary, "ffmpeg": find_ffmpeg()}
