"""Makes the message by which a job is submitted, for the command line and for Python. Light to import."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from raygrid.host.client.protocol import Message
from raygrid.host.image.frames import Ends, Turntable, check_job
from raygrid.host.image.frames import absolute as absolute_pattern
from raygrid.host.render.given_settings import SETTINGS, GivenSettings
from raygrid.host.text.clean_text import shown
from raygrid.node.errors import ArrayError

Name = str | os.PathLike[str]


class GivenJob(GivenSettings, total=False):
    """What a job may have by keyword, besides the settings of a render (`GivenSettings`).

    frames    first and last; None: all of a turntable, else one frame without number
    stats     path of the statistics, with %04d where several frames are
    transfer  "srgb" or "linear"
    budget    packets in flight below which new primary rays are admitted; None: as the service has it
    resume    skip frames whose files are there, whole, and of this very job
    client    in whose turn it is rendered; None: this connection's own
    turntable  so many frames make a shot of a still scene: the camera goes once round; `turn_scene`: the scene turns
    program   path of a program for the nodes, for an array that was launched to take it
    priority  -100 to 100: frames of higher ones go first, and one that runs is given up for them if it would take long
    """

    frames: Ends | None
    stats: Name | None
    transfer: str
    budget: int | None
    resume: bool
    client: str | None
    turntable: int | None
    turn_scene: bool
    program: Name | None
    priority: int


OF_JOB = tuple(name for name in GivenJob.__annotations__ if name not in SETTINGS)


@dataclass(frozen=True, kw_only=True)
class Submission:
    """A job as it is asked for (`raygrid.host.client.requests.SubmitMessage`, whose bounds the service checks).

    Paths may be relative to the current directory. budget: None for the service's own.
    """

    scene: Name
    outputs: Sequence[Name]
    settings: GivenSettings
    frames: Ends | None = None
    stats: Name | None = None
    transfer: str = "srgb"
    budget: int | None = None
    resume: bool = False
    client: str = ""
    turntable: Turntable | None = None
    program: Name | None = None
    priority: int = 0

    def message(self, follow: bool = False) -> Message:
        """The message, with whole paths; `follow`: whether to hear of the job. Raises ArrayError for what is no path."""
        turn = self.turntable
        message: Message = {
            "do": "submit",
            "outputs": [pattern_at("output", pattern) for pattern in self.outputs],
            "stats": None if self.stats is None else pattern_at("stats", self.stats),
            "scene": absolute("scene", self.scene),
            "settings": {name: plain(value) for name, value in self.settings.items() if value is not None},
            "frames": plain(self.frames),
            "transfer": self.transfer,
            "resume": self.resume,
            "client": self.client,
            "turntable": None if turn is None else {"frames": plain(turn.frames), "scene": turn.turn_scene},
            "program": None if self.program is None else absolute("program", self.program),
            "priority": plain(self.priority),
            "follow": follow,
        }
        return message if self.budget is None else message | {"budget": plain(self.budget)}


def submission_of(scene: Name, output: Name | Sequence[Name], client: str, given: GivenJob) -> Submission:
    """The job that a caller of the Python interface asks for.

    client  whose it is, if nothing is said of that
    Raises TypeError for another keyword, OutputError for names that cannot be.
    """
    unknown = set(given) - {*SETTINGS, *OF_JOB}
    if unknown:
        raise TypeError(f"the settings {sorted(unknown)} came, wanted some of {', '.join((*SETTINGS, *OF_JOB))}")
    settings = cast(GivenSettings, {name: value for name, value in given.items() if name in SETTINGS})
    job: dict[str, Any] = {name: value for name, value in given.items() if name in OF_JOB}
    turn, turn_scene = job.pop("turntable", None), job.pop("turn_scene", False)
    if job.get("frames") is None and isinstance(turn, int):
        job["frames"] = 1, turn
    if job.get("client") is None:
        job["client"] = client
    several = isinstance(output, Sequence) and not isinstance(output, str | bytes)
    outputs: list[Any] = list(output) if several else [output]  # type: ignore[arg-type]
    turntable = None if turn is None else Turntable(turn, turn_scene)
    return Submission(scene=scene, outputs=outputs, settings=settings, turntable=turntable, **job)


def checked_message(asked: Submission, follow: bool = False) -> Message:
    """The message of a job. Raises ArrayError and OutputError for names that cannot be, before anything is sent."""
    message = asked.message(follow)
    if asked.frames is None or _are_ends(asked.frames):
        check_job(message["outputs"], message["stats"], asked.frames)  # else the service says what is wrong
    return message


def _are_ends(frames: Any) -> bool:
    """Whether this is the first and the last of some frames."""
    pair = isinstance(frames, Sequence) and len(frames) == 2 and all(isinstance(number, int) for number in frames)
    return pair and 1 <= frames[0] <= frames[1]


def plain(value: Any) -> Any:
    """A value as a message can carry it: pairs as lists, numpy's numbers as numbers."""
    if isinstance(value, Sequence) and not isinstance(value, str | bytes | bytearray):
        return [plain(item) for item in value]
    if type(value).__module__ == "numpy" and hasattr(value, "tolist"):
        return value.tolist()
    return value


def absolute(what: str, path: Any) -> str:
    """A path from the root, for the service, which stands elsewhere. Raises ArrayError for what is no path.

    what  it is the path of
    """
    if not isinstance(path, str | os.PathLike) or not isinstance(os.fspath(path), str):
        first = " (a scene in memory is to be saved first)" if what == "scene" else ""
        raise ArrayError(f"{what} came as {shown(path)}, wanted the path of a file{first}")
    try:
        return os.path.abspath(path)
    except FileNotFoundError:
        raise ArrayError(
            f"{what} came as {os.fspath(path)!r}, wanted an absolute path: the current directory was removed"
        ) from None


def pattern_at(what: str, pattern: Any) -> str:
    """The name of an output with its whole path, in which a % of the current directory stands for itself. As `absolute`."""
    absolute(what, pattern)
    return absolute_pattern(pattern)
