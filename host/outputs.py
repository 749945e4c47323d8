"""The files that are written: looked at before the work, and afterwards there whole or not at all."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from raygrid.host.misuse import OutputMisuse
from raygrid.node.errors import OutputError


class Format(NamedTuple):
    """How a picture is encoded: Pillow's name, the longest side that the format can hold, and Pillow's options."""

    name: str
    longest: int
    options: dict[str, object]


SUMS = ".npy"  # the exact sums, no picture
PART = ".raygrid-"  # how the names of files begin that are not whole yet
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
}


def check_picture_path(path: str | Path) -> None:
    """Raise OutputError if a picture (or .npy) can surely not be written there: asked before the work, not after."""
    suffix = Path(path).suffix.lower()
    if os.fspath(path) and not os.path.isdir(path) and suffix != SUMS and suffix not in FORMATS:
        came = f"the suffix {suffix!r}" if suffix else "no suffix"
        raise OutputMisuse(f"{path}: the output has {came}, wanted one of: {' '.join((*FORMATS, SUMS))}")
    check_path(path)


def check_path(path: str | Path) -> None:
    """Raise OutputError if no file can be written there."""
    name = os.fspath(path)
    if not name or "\0" in name:
        raise OutputMisuse(f"an output came as {name!r}, wanted the name of a file")
    target = os.path.realpath(path)
    folder = os.path.dirname(target)
    if os.path.isdir(target):
        raise OutputError(f"{path}: the output is a directory, wanted a file")
    if not os.path.isdir(folder):
        raise OutputError(f"{path}: there is no directory {folder}, wanted one that is there")
    if os.path.exists(target) and not os.access(target, os.W_OK):
        raise OutputError(f"{path}: the output is write-protected, wanted a file that may be replaced")
    if os.path.exists(target) and not os.path.isfile(target):
        return
    try:  # what access() says of a directory is no proof: file systems can be mounted read-only, or be no real ones
        with contextlib.suppress(FileNotFoundError):
            os.stat(target)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise OutputError(f"{path}: no such file can be made in {folder} ({error.strerror})") from None


def check_side(path: str | Path, width: int, height: int) -> None:
    """Raise OutputError if the format cannot hold a picture of that size."""
    kind = FORMATS.get(Path(path).suffix.lower())
    if kind is not None and max(width, height) > kind.longest:
        raise OutputMisuse(
            f"{path}: the picture has {width}x{height} pixels, wanted sides of at most {kind.longest} for {kind.name}"
        )


def check_different(scene: str, outputs: Sequence[str]) -> None:
    """Raise OutputError if one file would be written twice, or the scene be written over."""
    taken = {os.path.realpath(scene): "the scene"} if "\0" not in scene else {}
    for output in outputs:
        place = os.path.realpath(output)
        if place in taken:
            raise OutputError(f"{output}: the output is the same file as {taken[place]}, wanted another")
        taken[place] = f"the output {output}"


def write_whole(path: str | Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file so that it appears whole or not at all; a link is followed, a device is simply written to.

    Raises OutputError if it cannot be written, and lets what `write` raises pass; neither leaves anything behind.
    """
    target = os.path.realpath(path)
    try:
        if os.path.exists(target) and not os.path.isfile(target):
            with open(target, "wb") as file:
                write(file)
            return
        part = os.path.join(os.path.dirname(target), f"{PART}{os.urandom(6).hex()}")
        try:
            with open(part, "xb") as file:
                write(file)
            os.replace(part, target)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(part)
            raise
    except OSError as error:
        raise OutputError(f"{path}: the file cannot be written ({error.strerror or error})") from None


def write_result(line: str) -> None:
    """Write a line to standard output. Raises OutputError if it cannot be written; what nobody reads is no error."""
    try:
        print(line, flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # so that closing it at the end says nothing
        if not isinstance(error, BrokenPipeError):
            raise OutputError(f"standard output cannot be written ({error.strerror})") from None
