"""What a client may ask of an array that stays, checked key by key before anything is done.

docs/service.md describes each request and its answer.
"""

from __future__ import annotations

import os
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    Strict,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from raygrid.host.frames import LAST_FRAME, MOST_FRAMES, Turntable, check_job
from raygrid.host.job import Settings
from raygrid.host.program_file import read_program
from raygrid.host.scene_store import Wanted
from raygrid.host.shot import MAX_FRAMES
from raygrid.host.wire import Message
from raygrid.node.errors import OutputError, ProtocolError

LONGEST_PATH = 4096


def _absolute(path: str) -> str:
    if not os.path.isabs(path) or "\0" in path:
        raise ValueError("wanted an absolute path")
    return path


Path = Annotated[str, Field(max_length=LONGEST_PATH), AfterValidator(_absolute)]
Frame = Annotated[int, Field(ge=1, le=LAST_FRAME)]
Number = Annotated[int, Field(ge=1, le=(1 << 53))]
Side = Annotated[int, Field(ge=1, le=65536)]


class Strictly(BaseModel):
    """Nothing unasked, nothing converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class SettingsOf(Strictly):
    """`raygrid.host.job.Settings`."""

    size: Annotated[tuple[Side, Side], Strict(False)] | None = None  # msgpack has lists, no tuples
    samples: Annotated[int, Field(ge=1, le=1 << 32)] | None = None
    depth: Annotated[int, Field(ge=1, le=31)] | None = None
    min_weight: Annotated[float, Field(ge=0.0, le=1e30)] | None = None
    highlights: bool | None = None
    split: Literal["balanced", "uniform"] = "balanced"


class TurntableOf(Strictly):
    """`raygrid.host.turntable`: so many frames a turn; `scene`: the scene turns, not the camera."""

    frames: Annotated[int, Field(ge=1, le=MAX_FRAMES)]
    scene: bool = False


class Submit(Strictly):
    """A job: frames of a scene.

    frames   first and last, or None: one frame, whose files are named as they are
    outputs  patterns of files, in which %04d stands for the frame's number and %% for a %; with frames .gif, .webp and
             .mp4 hold all of them
    client   whose turn it is in: clients are served in turn
    turntable  makes a shot of a still scene
    program  file of a program that the nodes are to run
    follow   tell of it until it has ended, as Follow does
    """

    do: Literal["submit"]
    scene: Path
    settings: SettingsOf = SettingsOf()
    frames: Annotated[tuple[Frame, Frame], Strict(False)] | None = None
    outputs: Annotated[list[Path], Field(min_length=1, max_length=16)]
    stats: Path | None = None
    transfer: Literal["srgb", "linear"] = "srgb"
    budget: Annotated[int, Field(ge=1, le=(1 << 32) - 1)] = 1 << 20
    resume: bool = False
    client: Annotated[str, Field(max_length=64)] = ""
    turntable: TurntableOf | None = None
    program: Path | None = None
    follow: bool = Field(default=False, exclude=True)

    @model_validator(mode="after")
    def _frames_fit(self) -> Self:
        if self.frames is not None:
            first, last = self.frames
            if not first <= last < first + MOST_FRAMES:
                raise ValueError(f"frames {first} to {last} came, wanted 1 to {MOST_FRAMES} of them")
        try:
            check_job(self.outputs, self.stats, self.frames)
        except OutputError as error:
            raise ValueError(str(error)) from None
        return self

    def wanted(self) -> Wanted:
        """What is to be read and made ready, as the front end has it. Raises SceneError for a program that is none."""
        program = None if self.program is None else read_program(self.program)
        turn = None if self.turntable is None else Turntable(self.turntable.frames, self.turntable.scene)
        return Wanted(self.scene, Settings(**dict(self.settings), program=program), turn, self.frames)


class Follow(Strictly):
    """Tell of a job until it has ended."""

    do: Literal["follow"]
    job: Number


class Cancel(Strictly):
    """Cancel jobs; None: all."""

    do: Literal["cancel"]
    jobs: Annotated[list[Number], Field(max_length=10_000)] | None


class Jobs(Strictly):
    """List jobs: those that have not ended, and the last `ended` of those that have."""

    do: Literal["jobs"]
    ended: Annotated[int, Field(ge=0, le=10_000)] = 10


class Status(Strictly):
    """Say how the array is."""

    do: Literal["status"]


class Probe(Strictly):
    """Tell how the nodes stand, `rate` times a second each, until the client leaves or asks for 0."""

    do: Literal["probe"]
    rate: Annotated[float, Field(ge=0.0, le=100.0)]


class Reset(Strictly):
    """Empty the array and begin the running frame again."""

    do: Literal["reset"]


class Down(Strictly):
    """End. `finish`: when all jobs have ended; `cancel`: cancel them first, or they go on at the next launch."""

    do: Literal["down"]
    finish: bool = False
    cancel: bool = False


Request = Submit | Follow | Cancel | Jobs | Status | Probe | Reset | Down
_REQUEST: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])


def read_request(message: Message) -> Request:
    """A request. Raises ProtocolError that names what is wrong with it."""
    try:
        return _REQUEST.validate_python(message)
    except ValidationError as error:
        raise ProtocolError(f"a request came that is none: {_told(error)}") from None


def read_job(message: Message) -> Submit:
    """A job out of the journal. Raises ProtocolError."""
    try:
        return Submit.model_validate(message)
    except ValidationError as error:
        raise ProtocolError(f"a job of the journal is none: {_told(error)}") from None


def _told(error: ValidationError) -> str:
    first: Any = error.errors(include_url=False)[0]
    place = ".".join(str(step) for step in first["loc"])
    came = repr(first["input"])
    return f"{place or 'it'}: {first['msg']}, {came[:60] + '...' if len(came) > 60 else came} came"
