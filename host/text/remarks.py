"""Passes remarks on to users of the Python interface: through `logging`, and through `warnings` where their Python asks.

The logger is "raygrid". A remark on a scene (a view that was invented, a statement that was left out) has the level INFO, what
nobody should miss (a fault that was made good, a picture that is all black, a first run that compiles) WARNING. Each is a
`RemarkWarning`, too, which Python ignores as it does a ResourceWarning, until a filter of its user says otherwise.
"""

from __future__ import annotations

import logging
import sys
import warnings

LOGGER = logging.getLogger("raygrid")


class RemarkWarning(UserWarning):
    """A remark on a scene, on a picture, or on what went wrong and was made good. Ignored unless it is asked for:

    warnings.simplefilter("always", raygrid.RemarkWarning)
    """


RemarkWarning.__module__ = "raygrid"  # as filters name it
IGNORED = ("ignore", None, RemarkWarning, None, 0)


def remark(text: str, level: int = logging.INFO) -> None:
    """Tell of a remark, as if the line of the user's that called raygrid had. Raises RemarkWarning if a filter says so."""
    LOGGER.log(level, "%s", text)
    if IGNORED not in warnings.filters:  # whoever collects warnings puts the filters of before back at the end
        warnings.simplefilter("ignore", RemarkWarning, append=True)
    warnings.warn(text, RemarkWarning, stacklevel=_callers_level())


def _callers_level() -> int:
    """How many calls above `remark` somebody else's code is."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and _is_ours(frame.f_globals.get("__name__", "")):
        frame, level = frame.f_back, level + 1
    return level


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in ("raygrid", "contextlib", "asyncio")
