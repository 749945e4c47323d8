"""What the command line says while it works: one live line on a terminal, nothing where there is none."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Any

import click

from raygrid.emulator.driver import Progress

WARMING_NOTICE = 1.5  # seconds of warming after which it is worth a word


class Talk:
    """Progress on standard error. Use as a context manager, so that the terminal is left as it was."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._live = not quiet and sys.stderr.isatty()
        self._bar: Any = None
        self._task: Any = None
        self._expected = 1
        self._begun = time.monotonic()
        self._told_warming = False

    def __enter__(self) -> Talk:
        if self._live:
            from rich.console import Console
            from rich.progress import BarColumn, Progress as Bar, SpinnerColumn, TextColumn, TimeRemainingColumn

            columns = (
                SpinnerColumn(),
                TextColumn("{task.description}"),
                BarColumn(bar_width=None),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(),
            )
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=None, rate="")
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def phase(self, what: str) -> None:
        """Say what is being done now."""
        if self._bar is not None:
            self._bar.reset(self._task, total=None, description=what, rate="")

    def remark(self, text: str) -> None:
        """A line that stays."""
        self.say(f"note: {text}")

    def say(self, text: str) -> None:
        """A line that stays, on standard error."""
        if self._quiet:
            return
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False)
        else:
            click.echo(text, err=True)

    def warming(self, done: int, total: int, what: str) -> None:
        """Progress of compiling; said aloud, terminal or not, if it takes long (only the first run does)."""
        slow = time.monotonic() - self._begun > WARMING_NOTICE
        if slow and not self._told_warming and not self._quiet:
            self._told_warming = True
            self.say("compiling the kernels, once on this computer; this takes up to a minute")
        if self._bar is not None and slow:
            self._bar.update(self._task, description=f"compiling: {what} ({done} of {total})")

    def expect(self, samples: int) -> None:
        """How many primary rays there will be, about."""
        self._expected = samples

    def watch(self, phase: str, now: Progress | None) -> None:
        """Told by `render_job`."""
        if self._bar is None:
            return
        if now is None:
            names = {"load": "loading surfaces", "trace": "tracing", "collect": "collecting pixels"}
            self._bar.reset(self._task, total=self._expected if phase == "trace" else None, description=names[phase])
            self._begun = time.monotonic()
            return
        packets = sum(now.died)
        rate = packets / max(time.monotonic() - self._begun, 1e-3)
        done = max(0, now.primaries - now.in_flight)
        self._bar.update(
            self._task, completed=min(done, self._expected), rate=f"{rate / 1e6:.2f} M packets/s, {now.in_flight:,} in flight"
        )
