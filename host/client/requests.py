"""Checks what a client asks of an array that stays, key by key, before anything is done.

docs/service.md describes each request and its answer.
"""

from __future__ import annotations

import os
from typing import Annotated, Any, Literal, Self, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    Strict,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from raygrid.host.client.protocol import Message
from raygrid.host.image.frames import LAST_FRAME, MOST_FRAMES, check_job
from raygrid.host.render.given_settings import GivenSettings, parted
from raygrid.host.scene import view
from raygrid.host.text import bounds
from raygrid.host.text.clean_text import shown
from raygrid.node.errors import OutputError, ProtocolError, SceneError

_PATH = f"an absolute path of at most {bounds.LONGEST_PATH} characters"
_SWITCH = "true or false"
# What is to stand where something else came, in words; a number's bounds are those below.
WANTED = {
    "do": "submit, follow, cancel, jobs, status, probe, reset or down",
    "scene": _PATH,
    "outputs": f"1 to {bounds.MOST_OUTPUTS} absolute paths of at most {bounds.LONGEST_PATH} characters",
    "stats": _PATH,
    "program": _PATH,
    "settings": "a map",
    "settings.size": f"sides of 1 to {bounds.MAX_SIDE} and at most {bounds.MAX_PIXELS:,} pixels, such as 640x480",
    "settings.samples": f"a whole number from 1 to {bounds.MAX_SAMPLES}",
    "settings.depth": f"a whole number from 1 to {bounds.MAX_DEPTH}",
    "settings.min_weight": f"a number from 0 to {bounds.MAX_WEIGHT}",
    "settings.highlights": _SWITCH,
    "settings.split": "balanced or uniform",
    **{f"settings.{name}": view.THREE for name in ("eye", "at", "up")},
    "settings.fov": view.ANGLE,
    "settings.camera": view.CAMERA,
    "settings.fit": f"one of: {', '.join(view.FITS)}",
    "settings.lights": f"a list of at most {view.MOST_LIGHTS}, each {view.LIGHT}",
    "settings.background": view.COLOUR,
    "settings.crease": view.CREASE,
    "frames": f"the first and the last of at most {MOST_FRAMES:,} frames, from 1 to {LAST_FRAME}",
    "turntable": "a number of frames",
    "turntable.frames": f"a whole number from 1 to {bounds.MAX_FRAMES:,}",
    "turntable.scene": _SWITCH,
    "transfer": "srgb or linear",
    "budget": f"a whole number from 1 to {bounds.MAX_BUDGET}",
    "resume": _SWITCH,
    "priority": f"a whole number from -{bounds.MAX_PRIORITY} to {bounds.MAX_PRIORITY}",
    "client": f"text of at most {bounds.LONGEST_CLIENT} characters",
    "follow": _SWITCH,
    "job": "the number of a job",
    "jobs": f"the numbers of at most {bounds.MOST_LISTED:,} jobs",
    "ended": f"a whole number from 0 to {bounds.MOST_LISTED:,}",
    "after": "the number of a job, or 0",
    "rate": f"0 to {bounds.MAX_RATE:g} samples a second",
    "finish": _SWITCH,
    "cancel": _SWITCH,
}


def _absolute(path: str) -> str:
    if not os.path.isabs(path) or "\0" in path:
        raise ValueError("wanted an absolute path")
    return path


Side = Annotated[int, Field(ge=1, le=bounds.MAX_SIDE)]


def _few_pixels(size: tuple[int, int]) -> tuple[int, int]:
    if size[0] * size[1] > bounds.MAX_PIXELS:
        raise ValueError(f"wanted at most {bounds.MAX_PIXELS} pixels")
    return size


Size = Annotated[tuple[Side, Side], Strict(False), AfterValidator(_few_pixels)]  # msgpack has lists, no tuples
Path = Annotated[str, Field(max_length=bounds.LONGEST_PATH), AfterValidator(_absolute)]
Frame = Annotated[int, Field(ge=1, le=LAST_FRAME)]
Number = Annotated[int, Field(ge=1, le=bounds.MAX_JOB)]


def _of_view(name: str) -> PlainValidator:
    """Checks a keyword of a view by itself, as everybody else's."""

    def check(value: object) -> object:
        try:
            made = view.view_of(cast(view.GivenView, {name: value}))
        except SceneError as error:
            raise ValueError(str(error)) from None
        return None if value is None else getattr(made, name)

    return PlainValidator(check)


class Strictly(BaseModel):
    """Nothing unasked, nothing converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class SettingsOf(Strictly):
    """`raygrid.host.render.machine_job.Settings`."""

    size: Size | None = None
    samples: Annotated[int, Field(ge=1, le=bounds.MAX_SAMPLES)] | None = None
    depth: Annotated[int, Field(ge=1, le=bounds.MAX_DEPTH)] | None = None
    min_weight: Annotated[float, Field(ge=0.0, le=bounds.MAX_WEIGHT)] | None = None
    highlights: bool | None = None
    split: Literal["balanced", "uniform"] = "balanced"
    eye: Annotated[Any, _of_view("eye")] = None
    at: Annotated[Any, _of_view("at")] = None
    up: Annotated[Any, _of_view("up")] = None
    fov: Annotated[float | None, _of_view("fov")] = None
    camera: Annotated[str | int | None, _of_view("camera")] = None
    fit: Annotated[str | None, _of_view("fit")] = None
    lights: Annotated[Any, _of_view("lights")] = None
    background: Annotated[Any, _of_view("background")] = None
    crease: Annotated[float | None, _of_view("crease")] = None

    def given(self) -> GivenSettings:
        """The settings by keyword, those left out that are None."""
        return cast(GivenSettings, {name: value for name, value in dict(self).items() if value is not None})

    @model_validator(mode="after")
    def _view_can_be(self) -> Self:
        try:
            view.view_of(parted(self.given())[1])
        except SceneError as error:
            raise ValueError(str(error)) from None
        return self


class TurntableOf(Strictly):
    """`raygrid.host.scene.animation.turntable`: so many frames a turn; `scene`: the scene turns, not the camera."""

    frames: Annotated[int, Field(ge=1, le=bounds.MAX_FRAMES)]
    scene: bool = False


class SubmitMessage(Strictly):
    """A job: frames of a scene.

    frames   first and last, or None: one frame, whose files are named as they are
    outputs  patterns of files, in which %04d stands for the frame's number and %% for a %; with frames .gif, .webp and
             .mp4 hold all of them
    client   whose turn it is in: clients are served in turn
    turntable  makes a shot of a still scene
    program  file of a program that the nodes are to run
    priority  frames of higher ones go first
    follow   tell of it until it has ended, as Follow does
    """

    do: Literal["submit"]
    scene: Path
    settings: SettingsOf = SettingsOf()
    frames: Annotated[tuple[Frame, Frame], Strict(False)] | None = None
    outputs: Annotated[list[Path], Field(min_length=1, max_length=bounds.MOST_OUTPUTS)]
    stats: Path | None = None
    transfer: Literal["srgb", "linear"] = "srgb"
    budget: Annotated[int, Field(ge=1, le=bounds.MAX_BUDGET)] = 1 << 20
    resume: bool = False
    client: Annotated[str, Field(max_length=bounds.LONGEST_CLIENT)] = ""
    turntable: TurntableOf | None = None
    program: Path | None = None
    priority: Annotated[int, Field(ge=-bounds.MAX_PRIORITY, le=bounds.MAX_PRIORITY)] = 0
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


class FollowMessage(Strictly):
    """Tell of a job until it has ended."""

    do: Literal["follow"]
    job: Number


class CancelMessage(Strictly):
    """Cancel jobs; None: all."""

    do: Literal["cancel"]
    jobs: Annotated[list[Number], Field(max_length=bounds.MOST_LISTED)] | None


class JobsMessage(Strictly):
    """List jobs: those that have not ended, and the last `ended` of those that have. `after`: only higher numbers."""

    do: Literal["jobs"]
    ended: Annotated[int, Field(ge=0, le=bounds.MOST_LISTED)] = 10
    after: Annotated[int, Field(ge=0, le=bounds.MAX_JOB)] = 0


class StatusMessage(Strictly):
    """Say how the array is."""

    do: Literal["status"]


class ProbeMessage(Strictly):
    """Tell how the nodes stand, `rate` times a second each, until the client leaves or asks for 0."""

    do: Literal["probe"]
    rate: Annotated[float, Field(ge=0.0, le=bounds.MAX_RATE)]


class ResetMessage(Strictly):
    """Empty the array and begin the running frame again."""

    do: Literal["reset"]


class DownMessage(Strictly):
    """End. `finish`: when all jobs have ended; `cancel`: cancel them first, or they go on at the next launch."""

    do: Literal["down"]
    finish: bool = False
    cancel: bool = False


Request = (
    SubmitMessage
    | FollowMessage
    | CancelMessage
    | JobsMessage
    | StatusMessage
    | ProbeMessage
    | ResetMessage
    | DownMessage
)
_REQUEST: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])


def read_request(message: Message) -> Request:
    """A request. Raises ProtocolError that names what is wrong with it."""
    try:
        return _REQUEST.validate_python(message)
    except ValidationError as error:
        raise ProtocolError(_first_fault(error, message)) from None


def read_job(message: Message) -> SubmitMessage:
    """A job out of the journal. Raises ProtocolError."""
    try:
        return SubmitMessage.model_validate(message)
    except ValidationError as error:
        raise ProtocolError(f"a job of the journal is none: {_first_fault(error, message)}") from None


def _first_fault(error: ValidationError, message: Message) -> str:
    """What is wrong with a map, by its first fault: what came and what was wanted."""
    first = error.errors(include_url=False)[0]
    steps = [str(step) for step in first["loc"] if not isinstance(step, int)]
    if steps and steps[0] == message.get("do"):  # that is how pydantic says which of the requests it is
        del steps[0]
    if first["type"] == "extra_forbidden":
        known = f"only what {message['do']} knows" if isinstance(message.get("do"), str) else "only what is known"
        return f"the key {'.'.join(steps)[:80]!r} came, wanted {known}"
    if first["type"] == "value_error" and steps in ([], ["settings"]):
        return str(first["ctx"]["error"])
    if first["type"].startswith("union_tag"):
        steps = ["do"]
    name = ".".join(steps)
    came, missing = _at(message, steps), first["type"] in ("missing", "union_tag_not_found")
    said = "is missing" if missing else f"came as {_shown(came, name)}"
    return f"{name.removeprefix('settings.') or 'a request'} {said}, wanted {WANTED.get(name, first['msg'])}"


def _at(message: Message, steps: list[str]) -> object:
    """What stands at a place in a message."""
    found: object = message
    for step in steps:
        found = found.get(step) if isinstance(found, dict) else None
    return found


def _shown(value: object, name: str) -> str:
    if name == "settings.size" and isinstance(value, list | tuple) and [type(side) for side in value] == [int, int]:
        return "x".join(map(shown, value))
    return shown(value)
