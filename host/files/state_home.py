"""Finds the directory of this user under which arrays that stay keep their state."""

from __future__ import annotations

import os
from pathlib import Path

from raygrid.node.errors import ArrayError


def state_home() -> Path:
    """Return the directory that holds the state directories of all arrays of this user. Raises ArrayError if there is none."""
    given = os.environ.get("XDG_STATE_HOME", "")
    if os.path.isabs(given):
        return Path(given) / "raygrid"
    home = os.path.expanduser("~")
    if not os.path.isabs(home):
        raise ArrayError("there is no home directory for the journal of an array: set XDG_STATE_HOME")
    return Path(home) / ".local" / "state" / "raygrid"
