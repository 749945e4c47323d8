"""Digests all that a picture depends on, by which `--resume` knows whether a file that is there is just that picture."""

from __future__ import annotations

import hashlib
from dataclasses import astuple, replace
from functools import lru_cache
from importlib.metadata import version
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from raygrid.host.render.machine_job import Settings


@lru_cache
def _version() -> str:
    return version("raygrid")


def picture_digest(contents: str, settings: Settings, frame: int | tuple[int, int] | None, transfer: str) -> str:
    """A digest of all that a picture depends on: contents, settings, program, frame, transfer, and this version.

    frame  its number; of a file that plays the first and the last
    The split is not part of it, for the picture does not depend on it.
    """
    program = None if settings.program is None else settings.program.digest
    words = astuple(replace(settings, split="", program=None))
    return hashlib.sha256(repr((_version(), contents, words, program, frame, transfer)).encode()).hexdigest()
