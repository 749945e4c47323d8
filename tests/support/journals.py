"""Journals that a disk has damaged."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from pathlib import Path


def damage(path: Path) -> None:
    """Zero all pages but the first, as a bad disk may."""
    with contextlib.closing(sqlite3.connect(path)) as base:
        base.execute("pragma wal_checkpoint(truncate)")
    with open(path, "r+b") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(4096)
        file.write(bytes(size - 4096))
