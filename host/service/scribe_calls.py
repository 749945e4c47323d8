"""Names what a service may ask of its scribe: a class a call, with its arguments and the type of its answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from raygrid.host.client.requests import SubmitMessage
    from raygrid.host.image.picture import Picture
    from raygrid.host.render.prepared import PreparedFrame
    from raygrid.node.programs import Program
    from raygrid.node.protocol import Frame

T = TypeVar("T")


class ScribeCall(Generic[T]):
    """A call that is answered by a T."""


class Unanswered:
    """A call that has no answer."""


@dataclass(frozen=True)
class CallDone(Generic[T]):
    """What a call returned."""

    value: T


@dataclass(frozen=True)
class CallFailed:
    """What a call failed with, in one line."""

    why: str


@dataclass(frozen=True)
class Begun:
    """A frame that can be traced, or needs not.

    ready    for the array; None if all files are there already
    files    path -> digest, of this frame alone
    remarks  on the scene and on what is written
    """

    ready: PreparedFrame | None
    files: dict[str, str]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class Finished:
    """A picture as its numbers."""

    sums: NDArray[np.int64]
    samples: int
    stats: dict[str, Any]

    @classmethod
    def of(cls, picture: Picture) -> Self:
        """The numbers of a picture."""
        return cls(picture.sums, picture.samples, picture.stats)


@dataclass(frozen=True)
class BeginFrame(ScribeCall[Begun]):
    """Read the scene, make a frame of it ready, and look at where its files go. `programs`: whether the array takes them."""

    job: int
    request: SubmitMessage
    frame: int | None
    programs: bool


@dataclass(frozen=True)
class PrepareAgain(ScribeCall["PreparedFrame"]):
    """Make another frame of the same job ready."""

    number: int


@dataclass(frozen=True)
class FinishFrame(ScribeCall[None]):
    """Write the files of the frame that was begun, each whole or not at all."""

    finished: Finished


@dataclass(frozen=True)
class ListLacking(ScribeCall[list[int]]):
    """Name the frames that files which hold all frames lack."""


@dataclass(frozen=True)
class KeepFrame(ScribeCall[None]):
    """Let one of them wait to be played."""

    number: int
    finished: Finished


@dataclass(frozen=True)
class PlayFrames(ScribeCall[dict[str, str]]):
    """Write the files that hold all frames; the answer is path -> digest."""


@dataclass(frozen=True)
class TraceBackground(ScribeCall["NDArray[np.int64]"]):
    """Work out what the rays see by a program that never enter the world box, int64 (pixels, 3)."""

    program: Program
    frame: Frame
    step: tuple[float, float, float]


@dataclass(frozen=True)
class WarmUp(Unanswered):
    """Import what larger frames need, while there is nothing else to do."""


@dataclass(frozen=True)
class SweepFilms(Unanswered):
    """Remove the frames that wait for jobs which have ended."""


AnyCall = (
    BeginFrame
    | PrepareAgain
    | FinishFrame
    | ListLacking
    | KeepFrame
    | PlayFrames
    | TraceBackground
    | WarmUp
    | SweepFilms
)
