"""Carries out `raygrid probe`: shows how the nodes of an array stand, live or from a recording."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

# What reads samples brings in compiled code, which takes a second or more: only after the terminal shows something.
if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.live import Live

    from raygrid.host.cli.probe_table import Shares
    from raygrid.host.probes.probing import Feed, Probing

REDRAW_SECONDS = 0.1
CLEAR = "\r\x1b[2K"


@dataclass(frozen=True)
class ProbeRequest:
    """What the command line asks for.

    name         of an array that stays
    replay       a recording to be read instead
    speed        how many times as fast as it was the recording is played, None: as fast as it can be read
    worst        only up to the recording's worst moment
    table        nodes by their busy share over all samples, at the end, instead of how they stand
    rate         samples a second of each node
    record, chrome_trace   files to write, or None
    prometheus   port on loopback, or None
    seconds      after which to end, or None: when the array does, or at Ctrl-C
    """

    name: str | None
    replay: str | None
    speed: float | None
    worst: bool
    table: bool
    rate: float
    as_json: bool
    record: str | None
    chrome_trace: str | None
    prometheus: int | None
    seconds: float | None

    @property
    def is_drawn(self) -> bool:
        """Whether the nodes are drawn as they stand, again and again."""
        return not (self.as_json or self.worst or self.table) and sys.stdout.isatty()


def run_probe(request: ProbeRequest) -> None:
    """Show samples until there are no more. Raises RaygridError."""
    with contextlib.ExitStack() as opened:
        with _notice(request):
            from raygrid.host.cli.probe_table import Shares
            from raygrid.host.probes.probing import Probing

            feed, head = opened.enter_context(_open(request))
        probing = opened.enter_context(Probing(feed.shape, feed.rate, request.record, request.chrome_trace))
        opened.enter_context(_served(request, probing))
        shares = Shares()
        _show(request, feed, probing, shares, opened.enter_context(_Screen(request, probing, shares, head)))


def _show(request: ProbeRequest, feed: Feed, probing: Probing, shares: Shares, screen: _Screen) -> None:
    """Take samples in until there are no more, or the time is up."""
    from raygrid.host.image.outputs import write_result
    from raygrid.host.probes.record import record_line

    each = request.as_json and not (request.worst or request.table)
    end = None if request.seconds is None else time.monotonic() + request.seconds
    for sample in feed.samples:
        if sample is not None:
            state = probing.take(sample)
            shares.take(state)
            probing.check()
            if each:
                write_result(record_line(state))
        screen.maybe_draw()
        if end is not None and time.monotonic() >= end:
            break


@contextlib.contextmanager
def _notice(request: ProbeRequest) -> Iterator[None]:
    """On a terminal, a line until there is something to be drawn."""
    if not request.is_drawn:
        yield
        return
    what = f"reading {request.replay}" if request.replay is not None else "asking the nodes how they stand"
    sys.stdout.write(f"{what} ...")
    sys.stdout.flush()
    try:
        yield
    finally:
        sys.stdout.write(CLEAR)
        sys.stdout.flush()


@contextlib.contextmanager
def _open(request: ProbeRequest) -> Iterator[tuple[Feed, str | None]]:
    """The samples, and a line on them."""
    from raygrid.host.probes.probing import Feed

    if request.replay is not None:
        from raygrid.host.probes.record import replay
        from raygrid.host.probes.replay import paced, worst_moment

        until, head = worst_moment(request.replay) if request.worst else (None, None)
        read = replay(request.replay)
        samples = islice(read.samples, until)
        try:
            yield Feed(read.shape, read.rate, samples if request.speed is None else paced(samples, request.speed)), head
        finally:
            read.close()
        return
    from raygrid.host.client.service_files import DEFAULT_NAME
    from raygrid.host.probes.service_probe import subscribe

    with subscribe(request.name or DEFAULT_NAME, request.rate) as feed:
        yield feed, None


def _served(request: ProbeRequest, probing: Probing) -> AbstractContextManager[object]:
    if request.prometheus is None:
        return contextlib.nullcontext()
    from raygrid.host.probes.metrics_server import Endpoint
    from raygrid.host.probes.prometheus import of_probes

    return Endpoint(lambda: of_probes(probing.gauges), request.prometheus)


class _Screen:
    """The live view on a terminal; elsewhere what there is to be told at the end, unless each sample is a line."""

    def __init__(self, request: ProbeRequest, probing: Probing, shares: Shares, head: str | None) -> None:
        self._request, self._probing, self._shares, self._head = request, probing, shares, head
        self._live: Live | None = None
        self._drawn = 0.0

    def __enter__(self) -> _Screen:
        if self._request.is_drawn:
            from rich.console import Console
            from rich.live import Live

            self._console = Console()
            self._live = Live(self._view(), console=self._console, auto_refresh=False, vertical_overflow="crop")
            self._live.start(refresh=True)
        return self

    def _view(self) -> RenderableType:
        from raygrid.host.cli.probe_view import view

        width, height = self._console.size
        return view(self._probing.gauges, width, height - 1, self._head)

    def maybe_draw(self) -> None:
        """Draw what has come, some times a second."""
        now = time.monotonic()
        if self._live is not None and now - self._drawn >= REDRAW_SECONDS:
            self._live.update(self._view(), refresh=True)
            self._drawn = now

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._live is not None:
            self._live.update(self._view(), refresh=True)
            self._live.stop()
        elif kind is None or (self._request.table and not issubclass(kind, Exception)):  # Ctrl-C ends a live table
            self._tell()

    def _tell(self) -> None:
        from raygrid.host.image.outputs import write_result

        if self._request.table:
            lines = self._shares.records() if self._request.as_json else self._shares.lines()
            write_result("\n".join(lines))
        elif self._request.as_json:
            from raygrid.host.probes.record import record_line

            if self._request.worst:
                write_result("\n".join(record_line(state) for state in self._probing.gauges))
        else:
            write_result(_drawn_once(self._probing, self._head))


def _drawn_once(probing: Probing, head: str | None) -> str:
    """How the nodes stand, as plain text; as wide as a terminal, if there is one."""
    from rich.console import Console

    from raygrid.host.cli.probe_view import WIDTH, view

    width = Console().size.width if sys.stdout.isatty() else WIDTH
    console = Console(file=sys.stdout, width=width, no_color=True)
    with console.capture() as text:
        console.print(view(probing.gauges, width, head=head))
    return text.get().rstrip()
