"""Opens standard streams that came closed, and lets them carry names of files that are any bytes."""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import sys

BYTES, MARKS = "raygrid.bytes", "raygrid.marks"  # error handlers of standard output and of standard error


def ready_streams() -> None:
    """Open what is closed of the three, so that no file of ours gets its number, and let them carry any name.

    A name that is not UTF-8 goes to standard output as the bytes that it is, so that another program can open the file,
    and to standard error as `caf\\xe9.nff`, which people can read.
    """
    for number in range(3):
        with contextlib.suppress(OSError):
            os.fstat(number)
            continue
        os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # gets the lowest number that is free: this one
    sys.stdin = sys.stdin or open(0, closefd=False)  # noqa: SIM115  (they stay open)
    sys.stdout = sys.stdout or open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", closefd=False)  # noqa: SIM115
    codecs.register_error(BYTES, _as_bytes)
    codecs.register_error(MARKS, _as_marks)
    for stream, handler in ((sys.stdout, BYTES), (sys.stderr, MARKS)):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=handler)


def shown_name(name: str) -> str:
    """Return a name as text that any encoding of Unicode can carry."""
    codecs.register_error(MARKS, _as_marks)
    return name.encode("utf-8", MARKS).decode("utf-8")


def _as_marks(error: UnicodeError) -> tuple[str, int]:
    """What cannot be encoded as `\\xe9` where it was a byte, else as `\\u20ac`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    marks = (
        f"\\x{ord(letter) - 0xDC00:02x}"
        if 0xDC80 <= ord(letter) <= 0xDCFF
        else letter.encode("ascii", "backslashreplace").decode("ascii")
        for letter in letters
    )
    return "".join(marks), error.end


def _as_bytes(error: UnicodeError) -> tuple[str | bytes, int]:
    """What cannot be encoded as the byte that it was, or as a mark."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    if 0xDC80 <= ord(error.object[error.start]) <= 0xDCFF:
        return bytes([ord(error.object[error.start]) - 0xDC00]), error.start + 1
    return _as_marks(UnicodeEncodeError(error.encoding, error.object, error.start, error.start + 1, error.reason))
