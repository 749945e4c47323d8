"""Writes an error as one line that can be shown, sent and recorded, whatever a scene has put into it."""

from __future__ import annotations

import errno
import traceback

from raygrid.host.text.clean_text import printable
from raygrid.host.text.log import log
from raygrid.node.errors import RaygridError


def told(error: BaseException) -> str:
    """Write an error as one line; what is not ours goes with its traceback to standard error, which is the array's log."""
    line = printable(" ".join(_shortened(str(error)).split()))
    if isinstance(error, RaygridError):
        return line
    if isinstance(error, MemoryError):
        return "out of memory"
    log("".join(traceback.format_exception(error)))
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return f"the array's service may open no more files: {line}"
    return printable(f"a bug: {type(error).__name__}: {line} (the array's log has more)")


def _shortened(text: str) -> str:
    """Not more of a text than could be shown; an error may hold a whole file."""
    return text if len(text) <= 1 << 14 else text[: 1 << 13] + " " + text[-(1 << 13) :]
