"""Makes the message by which a job is submitted, for the command line and for Python. Light to import."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from raygrid.host.client.protocol import Message, shown
from raygrid.host.image.frames import Ends, Turntable
from raygrid.host.image.frames import absolute as absolute_pattern
from raygrid.host.render.given_settings import GivenSettings
from raygrid.node.errors import ArrayError

Name = str | os.PathLike[str]


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
