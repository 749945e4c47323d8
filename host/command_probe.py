"""The command `raygrid probe`: how the nodes of an array stand, live or from a recording."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from raygrid.host.outputs import write_result
from raygrid.host.probe_record import record_line, replay
from raygrid.host.probe_view import view
from raygrid.host.probing import Feed, Probing

REDRAW_SECONDS = 0.1


@dataclass(frozen=True)
class Request:
    """What the command line asks for.

    name         of an array that stays
    replay       a recording to be read instead
    rate         samples a second of each node
    record, chrome_trace   files to write, or None
    prometheus   port on loopback, or None
    seconds      after which to end, or None: when the array does, or at Ctrl-C
    """

    name: str | None
    replay: str | None
    rate: float
    as_json: bool
    record: str | None
    chrome_trace: str | None
    prometheus: int | None
    seconds: float | None


def run_probe(request: Request) -> None:
    """Show samples until there are no more. Raises RaygridError."""
    with (
        _open(request) as feed,
        Probing(feed.shape, feed.rate, request.record, request.chrome_trace) as probing,
        _served(request, probing),
        _Screen(request.as_json, probing) as screen,
    ):
        end = None if request.seconds is None else time.monotonic() + request.seconds
        for sample in feed.samples:
            if sample is not None:
                state = probing.take(sample)
                probing.check()
                if request.as_json:
                    write_result(record_line(state))
            screen.maybe_draw()
            if end is not None and time.monotonic() >= end:
                break


@contextlib.contextmanager
def _open(request: Request) -> Iterator[Feed]:
    if request.replay is not None:
        read = replay(request.replay)
        try:
            yield Feed(read.shape, read.rate, read.samples)
        finally:
            read.close()
        return
    from raygrid.host.probe_service import subscribe
    from raygrid.host.service_files import DEFAULT_NAME

    with subscribe(request.name or DEFAULT_NAME, request.rate) as feed:
        yield feed


def _served(request: Request, probing: Probing) -> AbstractContextManager[Any]:
    if request.prometheus is None:
        return contextlib.nullcontext()
    from raygrid.host.prometheus import Endpoint

    return Endpoint(lambda: probing.gauges, request.prometheus)


class _Screen:
    """The live view on a terminal; elsewhere the last state at the end, unless lines of JSON go there."""

    def __init__(self, as_json: bool, probing: Probing) -> None:
        self._probing, self._json = probing, as_json
        self._live: Any = None
        self._drawn = 0.0

    def __enter__(self) -> _Screen:
        if not self._json and sys.stdout.isatty():
            from rich.console import Console
            from rich.live import Live

            self._live = Live(view(self._probing.gauges), console=Console(), auto_refresh=False)
            self._live.start()
        return self

    def maybe_draw(self) -> None:
        """Draw what has come, some times a second."""
        now = time.monotonic()
        if self._live is not None and now - self._drawn >= REDRAW_SECONDS:
            self._live.update(view(self._probing.gauges), refresh=True)
            self._drawn = now

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._live is not None:
            self._live.update(view(self._probing.gauges), refresh=True)
            self._live.stop()
        elif not self._json and kind is None:
            from rich.console import Console

            console = Console(file=sys.stdout, width=120, no_color=True)
            with console.capture() as text:
                console.print(view(self._probing.gauges))
            write_result(text.get().rstrip())
