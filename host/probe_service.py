"""Samples of an array that stays, through its service."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from raygrid.emulator.samples import Sample
from raygrid.host.client import Connection
from raygrid.host.probing import Feed
from raygrid.host.service_files import find
from raygrid.node.errors import ProtocolError

QUIET_SECONDS = 0.25  # without a sample after which the reader is given a turn


@contextlib.contextmanager
def subscribe(name: str, rate: float) -> Iterator[Feed]:
    """Samples of the array of this name, `rate` a second of each node, more if another client asks for more.

    Raises ArrayError if no such array is up, and, while samples are read, when it ends.
    """
    connection = Connection(find(name))
    with contextlib.closing(connection):
        answer = connection.ask({"do": "probe", "rate": float(rate)})
        nx, ny, nz = connection.record.shape
        yield Feed((nx, ny, nz), float(answer["rate"]), _samples(connection))


def _samples(connection: Connection) -> Iterator[Sample | None]:
    from pydantic import TypeAdapter, ValidationError

    reader = TypeAdapter(Sample)
    while True:
        try:
            event: dict[str, Any] = connection.next_event(None)
        except TimeoutError:
            yield None
            continue
        if event.get("what") == "sample":
            try:
                yield reader.validate_python(event["sample"])
            except (KeyError, ValidationError) as error:
                raise ProtocolError(
                    f"the array {connection.record.name!r} sent a sample that is none: {error}"
                ) from None
