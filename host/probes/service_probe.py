"""Asks the service of an array that stays for samples of its nodes."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

from raygrid.emulator.driver import NodeSample
from raygrid.host.client.connection import Connection, EventListener
from raygrid.host.client.protocol import Message
from raygrid.host.client.service_files import find
from raygrid.host.probes.probing import Feed
from raygrid.node.errors import ProtocolError

TURN_SECONDS = 0.25  # without a sample after which the reader is given a turn
QUIET_SECONDS = 5.0  # without a sample after which the service is asked again, to see that it is not hung


@contextlib.contextmanager
def subscribe(name: str, rate: float) -> Iterator[Feed]:
    """Samples of the array of this name, `rate` a second of each node, more if another client asks for more.

    Raises ArrayError if no such array is up, and, while samples are read, when it ends.
    """
    connection = Connection(find(name))
    request = {"do": "probe", "rate": float(rate)}
    with contextlib.closing(connection):
        listener = connection.listen(None)
        answer = connection.ask(request)
        nx, ny, nz = connection.record.shape
        yield Feed((nx, ny, nz), float(answer["rate"]), _samples(connection, listener, request))


def _samples(connection: Connection, listener: EventListener, request: Message) -> Iterator[NodeSample | None]:
    from pydantic import TypeAdapter, ValidationError

    reader = TypeAdapter(NodeSample)
    heard = time.monotonic()
    while True:
        event = listener.next(TURN_SECONDS)
        if event is None:
            if time.monotonic() - heard > QUIET_SECONDS:
                connection.ask(request)
                heard = time.monotonic()
            yield None
            continue
        heard = time.monotonic()
        try:
            yield reader.validate_python(event["sample"])
        except (KeyError, ValidationError) as error:
            raise ProtocolError(f"the array {connection.record.name!r} sent a sample that is none: {error}") from None
