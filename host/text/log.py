"""Writes to standard error, which is the log of an array that stays; a disk that takes no log is no end of what is being done."""

from __future__ import annotations

import contextlib
import sys
import time


def log(text: str) -> None:
    """Write a text, behind the time, if it can be written: the log lies on the disk that may be full, beside the journal."""
    with contextlib.suppress(OSError, ValueError):
        print(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text.rstrip()}", file=sys.stderr, flush=True)
