"""Declares what nodes say of themselves to the host on their control channels."""

from __future__ import annotations

from dataclasses import dataclass

from raygrid.emulator.processes.control import Message


@dataclass(frozen=True)
class EpochBegun:
    """The node obeys the reset to this epoch, or has just been forked for it."""

    epoch: int


@dataclass(frozen=True)
class LinksBroken:
    """The node gave up its links and waits for a reset."""

    epoch: int
    why: str


@dataclass(frozen=True)
class SampleTaken:
    """What is to be a sample of a probe, not checked yet (`emulator.driver.samples.read_sample`)."""

    fields: Message


@dataclass(frozen=True)
class FaultInjected:
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
