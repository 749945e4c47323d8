"""Says how far a command is: one live line on a terminal, next to nothing where there is none.

Where standard error is no terminal, only what a user must not miss is said: remarks on the scene, and the compiling of
a first run. Standard output has the names of the files written and nothing else.
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

import click

from raygrid.emulator.processes import KINDS, NOTE, kind_of
from raygrid.host.render.progress import PHASES, traced_part
from raygrid.host.text.clean_text import printable
from raygrid.host.text.tables import folded

if TYPE_CHECKING:
    from raygrid.emulator.driver import Progress
    from raygrid.host.render.retry import FaultReport

LOAD_PROGRAM = "loading the program (compiled once), surfaces"  # half a minute and more for a new program


class ProgressReporter:
    """Progress on standard error. Use as a context manager, so that the terminal is left as it was.

    quiet    say nothing at all
    program  whether the nodes are loaded with one, too
    """

    def __init__(self, quiet: bool, program: bool = False) -> None:
        self._quiet = quiet
        self._phases = PHASES | ({"load": LOAD_PROGRAM} if program else {})
        self._live = not quiet and sys.stderr.isatty()
        self._bar: Any = None
        self._task: Any = None
        self._expected = 1
        self._begun = time.monotonic()
        self._told_compiling: set[str] = set()
        self._frames = 0  # of a shot; 0: there is none
        self._before = (0, 0)  # frames that are done, and how many of them were there already
        self._shot_begun, self._number = 0.0, 0

    def __enter__(self) -> ProgressReporter:
        if self._live:
            self._bar = _new_bar()
            self._task = self._bar.add_task("", total=None, detail="")
            try:
                self._bar.start()
            except BaseException:  # Ctrl-C when the cursor was hidden already
                self._bar.stop()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def phase(self, what: str, total: int | None = None) -> None:
        """Say what is being done now. `total`: how much it is, if that is known; of a shot the bar is that of all frames."""
        self._begun = time.monotonic()
        if self._frames and self._bar is not None:
            self._bar.update(self._task, description=f"frame {self._number} ({self._frames} in all): {what}")
            return
        if self._bar is not None:
            self._bar.remove_task(self._task)  # a task once given a total cannot be without one again
            self._task = self._bar.add_task(printable(what), total=total, detail="")
            self._bar.refresh()  # now, or a short phase would never be seen

    def part(self, done: float, detail: str) -> None:
        """Say how much of the total of the phase is done."""
        if self._bar is not None:
            self._bar.update(self._task, completed=done, detail=detail)

    def remark(self, text: str) -> None:
        """A line on the scene or the picture that stays, terminal or not."""
        self._print(f"note: {text}")

    def fault(self, fault: FaultReport) -> None:
        """Told by a render session of what went wrong and was made good."""
        self.remark(f"{fault.what}; the array was reset in {fault.seconds[1]:.2f} s, and the frame begins anew")

    def say(self, text: str) -> None:
        """A line that stays, on a terminal."""
        if self._live:
            self._print(text)

    def table(self, lines: list[str]) -> None:
        """Lines that were asked for: on a terminal or not, quiet or not."""
        for line in lines:
            if self._bar is not None:
                self._bar.console.print(line, highlight=False, markup=False, soft_wrap=True)
            else:
                click.echo(line, err=True)

    def _print(self, text: str) -> None:
        if self._quiet:
            return
        text = printable(text)
        if sys.stderr.isatty():
            text = folded(text)
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False, soft_wrap=True)
        else:
            click.echo(text, err=True)

    def warming(self, done: int, total: int, what: str) -> None:
        """Told by the fork server of each function that it had to compile, which only a first run does, and of remarks."""
        if what.startswith(NOTE):
            self.remark(what.removeprefix(NOTE))
            return
        kind = kind_of(what)
        if kind is None:
            return
        if kind not in self._told_compiling:
            self._told_compiling.add(kind)
            which = f"kind {KINDS.index(kind) + 1} of {len(KINDS)}" if kind in KINDS else "of a kind of their own"
            self._print(f"compiling the kernels of {kind} ({which}), once on this computer: a minute")
            self.phase("", total)
        if self._bar is not None:
            words = {"description": what.removesuffix(f" for {kind}")[:32], "detail": f"{done} of {total}"}
            self._bar.update(self._task, completed=done, total=total, **words)

    def shot(self, frames: int) -> None:
        """What follows are so many frames of a shot, and the bar shows how much of them all is done; 0: no more."""
        self._frames = 0
        self.phase("", frames or None)
        self._frames, self._before, self._shot_begun = frames, (0, 0), time.monotonic()

    def frame(self, number: int, done: int, skipped: int) -> None:
        """This frame is next; `done` of the shot are done, `skipped` of which were there already."""
        self._number, self._before = number, (done, skipped)
        self._show_shot(0.0)

    def _show_shot(self, part: float) -> None:
        """How much of the shot is done, `part` of the present frame, and how long the rest will take."""
        if self._bar is None:
            return
        done, skipped = self._before
        share = (done - skipped + part) / max(self._frames - skipped, 1)
        left = _left(share, max(time.monotonic() - self._shot_begun, 1e-3))
        self._bar.update(self._task, completed=done + part, detail=f"{done} of {self._frames} done, {left}")

    def expect(self, samples: int) -> None:
        """How many primary rays there will be, about."""
        self._expected = samples

    def watch(self, phase: str, now: Progress | None) -> None:
        """Told by `render_job`."""
        if now is None:
            self.phase(self._phases[phase], self._expected if phase == "trace" else None)
        elif self._frames:
            self._show_shot(self._part(now))
        elif self._bar is not None:
            spent = max(time.monotonic() - self._begun, 1e-3)
            detail = f"{sum(now.died) / spent / 1e6:.2f} M packets/s, {_left(self._part(now), spent)}"
            self._bar.update(self._task, completed=self._part(now) * self._expected, detail=detail)

    def _part(self, now: Progress) -> float:
        return traced_part(now, self._expected)


def _new_bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        TextColumn("{task.fields[detail]}", markup=False),
        TimeElapsedColumn(),
    )
    return Bar(*columns, console=Console(stderr=True), transient=True)


def _left(part: float, spent: float) -> str:
    """How long the rest will take if it goes on like this."""
    if part < 0.01:
        return "time left unknown"
    seconds = round(spent * (1.0 - part) / part)
    if seconds < 60:
        return f"{seconds} s left"
    minutes, seconds = divmod(seconds, 60)
    return f"{minutes} min {seconds:02} s left" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02} min left"
