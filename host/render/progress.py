"""Says how far a render is to users of the Python interface, by a bar where a notebook shows it. Light to import."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from raygrid.emulator.driver import Progress

PERIOD = 0.1  # seconds between two pictures of a bar
PHASES = {
    "read": "reading the scene",
    "load": "loading surfaces",
    "trace": "tracing",
    "collect": "collecting pixels",
    "layers": "tracing layers",
    "write": "handing the picture over",
}


class RenderProgress(NamedTuple):
    """How far a render is.

    phase      "load", "trace", "collect", and "layers" if there are to be some; on an array that stays "read" before and
               "write" after them
    part       of the tracing that is done, 0.0 to 1.0
    in_flight  packets that are under way in the array
    frame      number of the frame of a shot, None for a single one
    """

    phase: str
    part: float = 0.0
    in_flight: int = 0
    frame: int | None = None


ProgressHook = Callable[[RenderProgress], object]


@contextlib.contextmanager
def following(progress: ProgressHook | bool, what: str) -> Iterator[ProgressHook | None]:
    """Whom to tell how far a render is.

    progress  a function to be called; True: a bar in a notebook, and nobody elsewhere; False: nobody
    what      is rendered, for the bar
    """
    if callable(progress):
        yield progress
    elif progress and in_notebook():
        bar = NotebookBar(what)
        try:
            yield bar
        finally:
            bar.close()
    else:
        yield None


def in_notebook() -> bool:
    """Whether IPython runs here with a front end that shows HTML; IPython on a terminal has none."""
    ipython: Any = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None


def traced_part(now: Progress, expected: int) -> float:
    """How much of the work is done: of the samples those that are born, of what came of them what has died.

    expected  how many primary rays there will be, about
    """
    return min(1.0, now.primaries / max(expected, 1)) * sum(now.died) / max(sum(now.born), 1)


class NotebookBar:
    """A bar below the cell that runs, which is gone when the picture is there."""

    def __init__(self, what: str) -> None:
        self._what, self._begun, self._drawn = what, time.monotonic(), -PERIOD
        self._now: RenderProgress | None = None
        self._handle: Any = None

    def __call__(self, now: RenderProgress) -> None:
        """Draw how far the render is, unless it was drawn just before and is in the same phase."""
        moment = time.monotonic()
        same = self._now is not None and self._now.phase == now.phase
        self._now = now
        if same and moment - self._drawn < PERIOD:
            return
        self._drawn = moment
        if self._handle is None:
            self._handle = import_module("IPython.display").display(self, display_id=True)
        else:
            self._handle.update(self)

    def close(self) -> None:
        """Take the bar away."""
        self._now = None
        if self._handle is not None:
            self._handle.update(self)

    def __repr__(self) -> str:
        now = self._now
        if now is None:
            return ""
        frame = "" if now.frame is None else f", frame {now.frame}"
        part = f" {now.part:.0%}" if now.phase == "trace" else ""
        return f"{self._what}{frame}: {PHASES.get(now.phase, now.phase)}{part}, {time.monotonic() - self._begun:.0f} s"

    def _repr_html_(self) -> str:
        if self._now is None:
            return ""
        value = (
            f' value="{self._now.part:.3f}"' if self._now.phase == "trace" else ""
        )  # without one it moves to and fro
        return f'<progress max="1"{value} style="width:20em;vertical-align:middle"></progress> {escape(repr(self))}'
