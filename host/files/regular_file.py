"""Reads files that others name: regular ones only, up to a length, so that no reading waits or goes on for ever.

A FIFO waits for a writer, a terminal for a key, /dev/zero never ends; some change when they are merely opened. So what a
name stands for is looked at before it is opened, and again when it is open, as it may be another file by then.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class Irregular(OSError):
    """The name is not that of a regular file."""


class TooLong(OSError):
    """The file is longer than what is taken."""


def open_regular(path: str | Path) -> BinaryIO:
    """Open a regular file to read. Raises OSError, Irregular for anything else than a regular file."""
    try:
        _check(os.stat(path).st_mode)
        # Not blocking: between the look and the opening it may have become a FIFO.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except ValueError:  # a NUL in the name
        raise FileNotFoundError(errno.ENOENT, "this is no name of a file") from None
    try:
        _check(os.fstat(descriptor).st_mode)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_open(file: BinaryIO, most: int) -> bytes:
    """Read all of an open file. Raises TooLong if that is more than `most` bytes."""
    # What a file says of its length may be wrong, as under /proc, or too little by the time it is read.
    length = os.fstat(file.fileno()).st_size
    parts, left = [], most + 1
    while left > 0 and length <= most and (part := file.read(min(max(length, 1 << 16), left))):
        parts.append(part)
        left -= len(part)
    if length > most or left <= 0:
        raise TooLong(f"the file has {max(length, most + 1 - left):,} bytes or more, wanted at most {most:,}")
    return parts[0] if len(parts) == 1 else b"".join(parts)


def read_regular(path: str | Path, most: int) -> bytes:
    """Read a regular file. Raises OSError, with Irregular and TooLong among them."""
    with open_regular(path) as file:
        return read_open(file, most)


def _check(mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise Irregular(f"{KINDS.get(stat.S_IFMT(mode), 'something else')} came, wanted a regular file")
