"""Tells who wants to know when numba begins and ends to compile a function."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import event as _event

event: Any = _event  # has no types

_COMPILING = "numba:compile"
Heard = Callable[[Any], None]  # takes the Python function that is compiled


def _unheard(_function: Any) -> None:
    """Nothing is done."""


class _Listener(event.Listener):  # type: ignore[misc]
    def __init__(self, begins: Heard, ends: Heard) -> None:
        self._begins, self._ends = begins, ends

    def on_start(self, event: Any) -> None:
        """Hear from numba that a function is to be compiled."""
        self._begins(event.data["dispatcher"].py_func)

    def on_end(self, event: Any) -> None:
        """Hear from numba that it is done."""
        self._ends(event.data["dispatcher"].py_func)


@contextlib.contextmanager
def compiling_heard_by(begins: Heard = _unheard, ends: Heard = _unheard) -> Iterator[None]:
    """Within, these are called with each function that is compiled and was not found on disk; what `begins` raises, whoever
    called the function gets. Functions are compiled within others."""
    with event.install_listener(_COMPILING, _Listener(begins, ends)):
        yield


def always_heard_by(begins: Heard, ends: Heard) -> None:
    """The same, until the process ends."""
    event.register(_COMPILING, _Listener(begins, ends))
