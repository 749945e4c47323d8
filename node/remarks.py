"""What code far below has to say to whoever uses the program: a line each, each but once in a process.

Nobody is asked to listen: without a listener a remark goes to standard error.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

Listener = Callable[[str], None]

_told: set[str] = set()


def to_stderr(text: str) -> None:
    """Say it on standard error, if there is one."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        print(f"raygrid: note: {text}", file=sys.stderr, flush=True)


_listener: Listener = to_stderr


def remark(about: str, text: str) -> None:
    """Say a thing, unless something was said `about` this already."""
    if about not in _told:
        _told.add(about)
        _listener(text)


@contextlib.contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Within, remarks go to this listener."""
    global _listener
    before, _listener = _listener, listener
    try:
        yield
    finally:
        _listener = before
