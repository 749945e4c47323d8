"""Names the tasks that a service hands to the thread that drives its array, and the events that this posts back.

events of the array   KernelsWarming, ArrayReady, ArrayBroken, ArrayRepaired, ArrayReset, NodeSampled, ArrayEnded
events of a task      FrameBegun, SceneRemarked, FrameMoved; the last of it is one of FrameDone, FrameFailed and
                      FrameInterrupted
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from raygrid.emulator.driver import NodeSample
    from raygrid.host.client.facts import MovedFacts
    from raygrid.host.client.requests import SubmitMessage


@dataclass
class Options:
    """Of the array: processors on each axis, most packets a message, seconds until it is taken to hang, its journal,
    whether it takes programs, and whether scenes may refer to files outside their folders."""

    shape: tuple[int, int, int]
    batch: int = 4096
    patience: float = 30.0
    journal: Path = field(default_factory=Path)
    programs: bool = False
    outside: bool = False


@dataclass(frozen=True)
class Task:
    """A frame to be rendered. `frame` is None if the job names no frames; `last`: no other of the job is left."""

    serial: int
    job: int
    frame: int | None
    request: SubmitMessage
    last: bool = True


@dataclass(frozen=True)
class KernelsWarming:
    """Kernels are compiled or loaded: `done` of `total` of them, `what` just now."""

    done: int
    total: int
    what: str


@dataclass(frozen=True)
class ArrayReady:
    """The array can render. `pids`: of the nodes, x fastest."""

    pids: list[int]


@dataclass(frozen=True)
class ArrayBroken:
    """The array cannot render, and could not be launched again. `task`: the frame that has to wait for it."""

    why: str
    task: Task | None = None


@dataclass(frozen=True)
class ArrayRepaired:
    """The array failed and was repaired. `task`: the frame that was under way."""

    fault: str
    task: Task | None


@dataclass(frozen=True)
class ArrayReset:
    """The array was reset, as asked."""


@dataclass(frozen=True)
class NodeSampled:
    """How a node stands."""

    sample: NodeSample


@dataclass(frozen=True)
class ArrayEnded:
    """The thread has ended, and the array with it."""


@dataclass(frozen=True)
class FrameBegun:
    """A frame was begun."""

    task: Task


@dataclass(frozen=True)
class SceneRemarked:
    """There is something to be said of the frame's scene."""

    task: Task
    text: str


@dataclass(frozen=True)
class FrameMoved:
    """How far a frame is: its phase, the part of its rays that is traced (0 to 1), packets in flight."""

    task: Task
    phase: str = "read"
    part: float = 0.0
    in_flight: int = 0

    @property
    def facts(self) -> MovedFacts:
        """The same as a message has it."""
        return {"phase": self.phase, "part": self.part, "in_flight": self.in_flight}


@dataclass(frozen=True)
class FrameDone:
    """The files of a frame are there.

    files    path -> digest, of this frame alone; `skipped`: they were there already
    played   path -> digest, of those that hold all frames of the job, if they were written now
    seconds  by phase, and `whole`; empty for a frame that was skipped
    """

    task: Task
    files: dict[str, str]
    played: dict[str, str]
    skipped: bool
    seconds: Mapping[str, float]


@dataclass(frozen=True)
class FrameFailed:
    """A frame cannot be rendered."""

    task: Task
    why: str


@dataclass(frozen=True)
class FrameInterrupted:
    """A frame was given up, as asked."""

    task: Task


TaskEnd = FrameDone | FrameFailed | FrameInterrupted
ArrayEvent = KernelsWarming | ArrayReady | ArrayBroken | ArrayRepaired | ArrayReset | NodeSampled | ArrayEnded
Event = ArrayEvent | FrameBegun | SceneRemarked | FrameMoved | TaskEnd
