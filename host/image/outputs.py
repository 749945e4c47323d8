"""Checks outputs before the work, and writes them afterwards, each whole or not at all.

`-` is standard output. What is read is never written over (`input_guard`).
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, BinaryIO, NamedTuple

from raygrid.host.files.input_guard import STANDARD, check_kept
from raygrid.host.files.part_files import replacing
from raygrid.host.text.misuse import OutputMisuse
from raygrid.host.text.tables import folded
from raygrid.node.errors import OutputError


class Format(NamedTuple):
    """An encoding of pictures: Pillow's name, the longest side that the format can hold, and Pillow's options."""

    name: str
    longest: int
    options: dict[str, object]


SUMS = ".npy"  # the exact sums, no picture
JPEG = Format("JPEG", 65_500, {"quality": 95, "subsampling": 0})
FORMATS = {
    ".png": Format("PNG", 1 << 31, {}),
    ".jpg": JPEG,
    ".jpeg": JPEG,
    ".webp": Format("WEBP", 16_383, {"lossless": True}),
    ".tif": Format("TIFF", 1 << 31, {}),
    ".tiff": Format("TIFF", 1 << 31, {}),
    ".bmp": Format("BMP", 1 << 31, {}),
    ".ppm": Format("PPM", 1 << 31, {}),
    ".tga": Format("TGA", 65_535, {}),
    ".jp2": Format("JPEG2000", 1 << 31, {"irreversible": False}),
}
RADIANCE = (".pfm", ".hdr", ".exr")  # linear radiance (`radiance`)
LONGEST_PLAYED = {".gif": 65_535, ".mp4": 16_384}  # sides of files that play; a .webp is a picture, too


def suffix_of(path: str | Path) -> str:
    """Return the suffix that chooses the format; a picture on standard output is a PNG."""
    return ".png" if os.fspath(path) == STANDARD else Path(path).suffix.lower()


def check_picture_path(path: str | Path) -> None:
    """Raise OutputError if a picture (or .npy) can surely not be written there: asked before the work, not after."""
    if os.fspath(path) and not os.path.isdir(path):
        check_format(path)
    check_path(path)
    if os.fspath(path) == STANDARD and _standard().isatty():
        raise OutputError("-: standard output is a terminal, wanted a pipe or a file for a picture")


def check_format(path: str | Path) -> None:
    """Raise OutputError if the suffix names none of our formats, or one whose library is not there."""
    suffix = suffix_of(path)
    if suffix not in (SUMS, *RADIANCE, *FORMATS):
        came = f"the suffix {suffix!r}" if suffix else "no suffix"
        raise OutputMisuse(f"{path}: the output has {came}, wanted one of: {' '.join((*FORMATS, *RADIANCE, SUMS))}")
    if suffix == ".exr":
        check_exr(path)


def check_exr(path: str | Path) -> None:
    """Raise OutputError if the library for EXR files is not there."""
    if importlib.util.find_spec("OpenEXR") is None:
        raise OutputError(f"{path}: OpenEXR is not installed, wanted the extra: pip install 'raygrid[exr]'")


def check_path(path: str | Path) -> None:
    """Raise OutputError if no file can be written there."""
    name = os.fspath(path)
    if not name or "\0" in name:
        raise OutputMisuse(f"an output came as {name!r}, wanted the name of a file")
    if name == STANDARD:
        _standard()
        return
    target = os.path.realpath(path)
    folder = os.path.dirname(target)
    there = _mode(path)
    if there is not None and stat.S_ISDIR(there):
        raise OutputError(f"{path}: the output is a directory, wanted a file")
    if there is not None and not stat.S_ISREG(there):
        _check_kind(path, there)
    if not os.path.isdir(folder):
        raise OutputError(f"{path}: there is no directory {folder}, wanted one that is there")
    if there is not None and not os.access(target, os.W_OK):
        raise OutputError(f"{path}: the output is write-protected, wanted a file that may be replaced")
    if there is not None and not stat.S_ISREG(there):
        return
    try:  # what access() says of a directory is no proof: file systems can be mounted read-only, or be no real ones
        with contextlib.suppress(FileNotFoundError):
            os.stat(target)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise OutputError(f"{path}: no such file can be made in {folder} ({error.strerror})") from None


def check_named(path: str | Path) -> None:
    """Raise OutputError if no file can be written there; standard output is none."""
    if os.fspath(path) == STANDARD:
        raise OutputMisuse("-: the output is standard output, wanted the name of a file")
    check_path(path)


def _mode(path: str | Path) -> int | None:
    """What is there, behind links; None: nothing."""
    try:
        return os.stat(path).st_mode
    except OSError:
        return None


def _check_kind(path: str | Path, mode: int) -> None:
    """Raise OutputError for what is neither a file nor a device such as /dev/null: a pipe may never be read, and a disk
    is not to be written over."""
    if not stat.S_ISCHR(mode):
        kind = "pipe" if stat.S_ISFIFO(mode) else "disk" if stat.S_ISBLK(mode) else "socket"
        raise OutputError(f"{path}: the output is a {kind}, wanted a file")


def check_folder(path: str | Path) -> None:
    """Raise OutputError if there is no such folder and none can be made."""
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: the output is a file, wanted a folder")
    if not folder.is_dir() and not folder.parent.is_dir():
        raise OutputError(f"{folder}: there is no directory {folder.parent}, wanted one that is there")


@contextlib.contextmanager
def made_folder(path: str | Path) -> Iterator[None]:
    """Have a folder in this block; one that was made for it goes again if the block fails and has left it empty.

    Raises OutputError if there is none and none can be made.
    """
    check_folder(path)
    made = not os.path.isdir(path)
    try:
        Path(path).mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: the folder cannot be made ({error.strerror})") from None
    try:
        yield
    except BaseException:
        if made:
            with contextlib.suppress(OSError):
                os.rmdir(path)
        raise


def check_side(path: str | Path, width: int, height: int) -> None:
    """Raise OutputError if the format cannot hold a picture of that size."""
    suffix = suffix_of(path)
    kind = FORMATS.get(suffix)
    longest = LONGEST_PLAYED.get(suffix, 1 << 31) if kind is None else kind.longest
    if max(width, height) > longest:
        name = suffix[1:].upper() if kind is None else kind.name
        raise OutputMisuse(
            f"{path}: the picture has {width}x{height} pixels, wanted sides of at most {longest} for {name}"
        )


def write_whole(path: str | Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file so that it appears whole or not at all; a link is followed, a device is simply written to.

    Raises OutputError if it cannot be written, or is a file that is read (`input_guard`), and lets what `write` raises pass;
    neither leaves anything behind.
    """
    check_kept(path)
    if os.fspath(path) == STANDARD:
        _write_standard(write)
        return
    target = os.path.realpath(path)
    try:
        mode = _mode(target)
        if mode is not None and not stat.S_ISREG(mode):
            _check_kind(path, mode)
            with open(target, "wb", opener=_open_device) as file:
                write(file)
            return
        with replacing(target) as (_, file):
            write(file)
    except OSError as error:
        raise OutputError(f"{path}: the file cannot be written ({error.strerror or error})") from None


def open_now(path: str | Path) -> IO[str]:
    """Open a file to which lines are added as they come, emptied; a device without ever waiting for it. Raises OSError."""
    mode = _mode(path)
    plain = mode is None or stat.S_ISREG(mode)
    return open(path, "w", buffering=1, encoding="utf-8", opener=None if plain else _open_device)


def _open_device(path: str, _flags: int) -> int:
    """Open a device, or what has come in its place meanwhile, without ever waiting for it."""
    return os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)


# --- standard output -----------------------------------------------------------------------------


def _standard() -> IO[str]:
    """Standard output. Raises OutputError if it is closed."""
    if sys.stdout is None or sys.stdout.closed:
        raise OutputError("-: standard output is closed, wanted it open")
    return sys.stdout


def _write_standard(write: Callable[[BinaryIO], object]) -> None:
    data = io.BytesIO()
    write(data)
    out = _standard()
    with _told():
        if hasattr(out, "buffer"):
            out.flush()
            out.buffer.write(data.getbuffer())
        else:  # taken by a test or a notebook
            out.write(data.getvalue().decode("utf-8", "surrogateescape"))
        out.flush()


def write_result(line: str) -> None:
    """Write a line to standard output. Raises OutputError if it cannot be written; what nobody reads is no error."""
    with _told():
        print(line, flush=True)


def write_lines(lines: Iterable[str]) -> None:
    """Write lines for people, which a terminal does not break within words. Raises OutputError as `write_result` does."""
    text = "\n".join(lines)
    write_result(folded(text) if sys.stdout.isatty() else text)


def write_names(paths: Sequence[str], results: Sequence[str | None]) -> None:
    """Tell of the files that were written, unless a result itself went to standard output."""
    if STANDARD not in results:
        for path in paths:
            write_result(path)


@contextlib.contextmanager
def _told() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # so that closing it at the end says nothing
        if not isinstance(error, BrokenPipeError):
            raise OutputError(f"standard output cannot be written ({error.strerror})") from None
