"""Declares what nodes say of themselves to the host on their control channels."""

from __future__ import annotations

from typing import NamedTuple

from raygrid.emulator.processes.control import Message


class EpochBegun(NamedTuple):
    """The node obeys the reset to this epoch, or has just been forked for it."""

    epoch: int


class LinksBroken(NamedTuple):
    """The node gave up its links and waits for a reset."""

    epoch: int
    why: str


class SampleTaken(NamedTuple):
    """What is to be a sample of a probe, not checked yet (`emulator.driver.samples.read_sample`)."""

    fields: Message


class FaultInjected(NamedTuple):
    """A message was hit by a fault on purpose."""


NodeMessage = EpochBegun | LinksBroken | SampleTaken | FaultInjected


def read_node_message(message: Message) -> NodeMessage | None:
    """What a map says; None if it is nothing that a node says."""
    match message:
        case {"is": "reset", "epoch": int(epoch)}:
            return EpochBegun(epoch)
        case {"is": "broken", "epoch": int(epoch), "why": str(why)}:
            return LinksBroken(epoch, why)
        case {"is": "sample"}:
            return SampleTaken(message)
        case {"is": "injected"}:
            return FaultInjected()
    return None
