"""Serves figures for Prometheus over HTTP, on loopback only, in a thread of its own.

A visit has a thread for as long as it takes, which is bounded, and so is the number of visits at once: who comes when
there are too many takes the place of the one that has been there longest, and waits until that has gone. So connections
that say nothing cost nothing for long, and keep nobody from the figures.
"""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from socketserver import ThreadingMixIn
from typing import TYPE_CHECKING
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from raygrid.node.errors import ArrayError

if TYPE_CHECKING:
    from prometheus_client import Metric

LOOPBACK = "127.0.0.1"
MOST_VISITS = 8
VISIT_SECONDS = 5.0
LOOK_SECONDS = 0.25  # between two looks for visits that take too long
PATH = "metrics"

Visitor = socket.socket | tuple[bytes, socket.socket]  # as socketserver has it; here always the first
Families = Callable[[], Iterator["Metric"]]


class _Visit(WSGIRequestHandler):
    timeout = VISIT_SECONDS

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing."""


class _Server(ThreadingMixIn, WSGIServer):
    """Serves a bounded number of visits, each for a bounded time."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._left = threading.Condition()  # one has gone
        self._visits: dict[Visitor, float] = {}  # socket -> when it came, oldest first
        super().__init__(address, _Visit)

    def process_request(self, request: Visitor, client_address: object) -> None:
        """Begin a visit, in a thread of its own."""
        with self._left:
            # One for each that came since there were too many: those that were told to go may not have gone yet.
            for visit in list(self._visits)[: max(0, len(self._visits) + 1 - MOST_VISITS)]:
                _hang_up(visit)
            place = self._left.wait_for(lambda: len(self._visits) < 2 * MOST_VISITS, VISIT_SECONDS)
            if place:
                self._visits[request] = time.monotonic()
        if not place:
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def shutdown_request(self, request: Visitor) -> None:
        """End a visit."""
        with self._left:
            self._visits.pop(request, None)
            self._left.notify_all()
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Called some times a second: end what takes too long."""
        now = time.monotonic()
        with self._left:
            for request, came in self._visits.items():
                if now - came > VISIT_SECONDS:
                    _hang_up(request)

    def handle_error(self, request: Visitor, client_address: object) -> None:
        """A visitor that is gone is nothing to speak of; a bug is."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)

    def close(self) -> None:
        """End all visits and the server."""
        with self._left:
            for request in self._visits:
                _hang_up(request)
        self.server_close()  # waits for the threads


def _hang_up(request: Visitor) -> None:
    """Let who reads or writes there find the end."""
    with contextlib.suppress(OSError):
        assert isinstance(request, socket.socket)
        request.shutdown(socket.SHUT_RDWR)


class Endpoint:
    """Serves figures at http://127.0.0.1:PORT/metrics in a thread of its own. Use as a context manager.

    families  of metrics, asked for at each visit, in its thread
    port      0: any free one; see `port` afterwards
    Raises ArrayError if the library is not installed, or the port is taken.
    """

    def __init__(self, families: Families, port: int) -> None:
        try:
            from prometheus_client import CollectorRegistry, make_wsgi_app
        except ImportError:
            raise ArrayError("the Prometheus endpoint needs prometheus_client: pip install prometheus_client") from None
        self._families = families
        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)
        try:
            self._server = _Server((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            raise ArrayError(f"no Prometheus endpoint can be opened at {LOOPBACK}:{port} ({error})") from None
        self._server.set_app(make_wsgi_app(registry))
        self.port = int(self._server.server_port)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(LOOK_SECONDS,), name="prometheus", daemon=True
        )
        self._thread.start()

    @property
    def url(self) -> str:
        """Where the figures are."""
        return figures_url(self.port)

    def describe(self) -> list[Metric]:
        """Nothing is known before the first visit."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Told by the registry to tell."""
        return self._families()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._thread.join()
        self._server.close()

    def __enter__(self) -> Endpoint:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def figures_url(port: int) -> str:
    """Where the figures of a port are."""
    return f"http://{LOOPBACK}:{port}/{PATH}"
