"""Reads the numbers of a job's frames and the names of their files. Light to import.

The grammar of a name, the same for `render` and `submit`: %d, %4d or %04d stands for the frame's number, %% for a %.
A name without a number is that of one picture, or of a file that plays and holds all frames.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from raygrid.host.image.layer_names import LayerFile, check_outputs_of_layers, layer_files
from raygrid.host.text.misuse import OutputMisuse, SceneMisuse
from raygrid.node.errors import SceneError

FIELD = re.compile(r"%(?:(?P<width>0?[1-9])?d|%)")
LAST_FRAME = 999_999_999
MOST_FRAMES = 100_000  # of a job
LONGEST_NUMBER = 1_000_000  # of a shot whose length is not known yet
PLAYED = (".gif", ".webp", ".mp4")  # a .webp plays only if several frames are asked for
ONLY_PLAYED = (".gif", ".mp4")

Ends = tuple[int, int]


def parse_frames(text: str) -> Ends:
    """First and last frame of "A-B", or of "A" alone. Raises ValueError, saying what was wanted."""
    found = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9}))?", text)
    first, last = (int(found[1]), int(found[2] or found[1])) if found else (0, 0)
    if not 1 <= first <= last:
        raise ValueError("wanted frames such as 1-48 or 7")
    if last >= first + MOST_FRAMES:
        raise ValueError(f"wanted at most {MOST_FRAMES} frames")
    return first, last


def _places(pattern: str) -> int:
    """How many places for a number there are. Raises OutputError for a % that means nothing."""
    if "%" in FIELD.sub("", pattern):
        raise OutputMisuse(
            f"{pattern}: the output has a % in its name that is no number, wanted one such as %04d, or %% for a %"
        )
    return sum(field[0] != "%%" for field in FIELD.finditer(pattern))


def has_number(pattern: str) -> bool:
    """Whether a name has a place for the number of a frame. Raises OutputError for a % that means nothing."""
    return _places(pattern) > 0


def path_of(pattern: str, frame: int | None) -> str:
    """The file of a frame. `frame` may be None where the name has no number."""
    return FIELD.sub(lambda field: "%" if field[0] == "%%" else f"{frame:{field['width'] or ''}d}", pattern)


def pattern_of(path: str) -> str:
    """The pattern that names just this file."""
    return path.replace("%", "%%")


def absolute(pattern: str | os.PathLike[str]) -> str:
    """The pattern with its whole path: a % in the name of the current directory stands for itself."""
    if os.path.isabs(pattern):
        return os.path.normpath(pattern)
    return os.path.normpath(os.path.join(pattern_of(os.getcwd()), pattern))


def is_played(pattern: str, shot: bool) -> bool:
    """Whether one file holds all frames; `shot`: whether frames of a shot are asked for."""
    suffix = Path(pattern).suffix.lower()
    return not has_number(pattern) and (suffix in ONLY_PLAYED or (shot and suffix in PLAYED))


def wants_shot(frames: Ends | None, turns: bool, outputs: Sequence[str], stats: str | None = None) -> bool:
    """Whether frames of a shot are asked for, and not a picture of the scene as it stands.

    frames    what was asked for by number, or None; `turns`: by a turntable
    outputs, stats  patterns of all files that a frame has: names with a number ask for the whole shot
    """
    return frames is not None or turns or _asks_for_shot(outputs, stats) is not None


def _asks_for_shot(outputs: Sequence[str], stats: str | None) -> str | None:
    """The first of the patterns that is one of several frames, None if there is none. Raises OutputError."""
    patterns = (*outputs, *([] if stats is None else [stats]))
    return next((name for name in patterns if has_number(name) or is_played(name, False)), None)


def check_patterns(outputs: Sequence[str], stats: str | None, frames: Ends | None, shot: bool) -> None:
    """Raise OutputError if the files of several frames would have one name, or a name says not what it is.

    frames  first and last, or None: all of a shot, whose length is not known yet
    """
    for pattern in (*outputs, *([] if stats is None else [stats])):
        if _places(pattern) > 1:
            raise OutputMisuse(
                f"{pattern}: the output has {_places(pattern)} places for the frame's number, wanted one, such as f_%04d.png"
            )
    if not shot or (frames is not None and frames[0] == frames[1]):
        return
    for pattern in outputs:
        if not has_number(pattern) and not is_played(pattern, shot):
            raise OutputMisuse(
                f"{pattern}: several frames would go to this one file, wanted a number such as %04d in its name, "
                f"or one of: {' '.join(PLAYED)}"
            )
    if stats is not None and not has_number(stats):
        raise OutputMisuse(f"{stats}: statistics of several frames came, wanted a number such as %04d in the name")


def check_job(outputs: Sequence[str], stats: str | None, frames: Ends | None) -> None:
    """Raise OutputError for names of files that a job cannot have. `frames`: those that it names, or None."""
    if frames is None and (name := _asks_for_shot(outputs, stats)) is not None:
        raise OutputMisuse(
            f"{name}: the output is one of several frames and none were named, wanted frames such as 1-48"
        )
    check_patterns(outputs, stats, frames, frames is not None)


class FrameNames(NamedTuple):
    """The names of the files of a job's frames.

    single  patterns of files that each frame has for its own
    played  files that hold all frames
    stats   pattern of the statistics that each frame has, or None
    layers  that each frame has, in the files of `single` or beside them
    """

    single: tuple[str, ...]
    played: tuple[str, ...]
    stats: str | None
    layers: tuple[str, ...] = ()

    @classmethod
    def split(cls, outputs: Sequence[str], stats: str | None, shot: bool, layers: tuple[str, ...] = ()) -> FrameNames:
        """The patterns told apart; `shot`: whether frames of a shot are asked for. Raises OutputError."""
        played = [pattern for pattern in outputs if is_played(pattern, shot)]
        single = tuple(pattern for pattern in outputs if pattern not in played)
        check_outputs_of_layers(single, played, layers)
        return cls(single, tuple(path_of(pattern, None) for pattern in played), stats, layers)

    @classmethod
    def checked(
        cls,
        outputs: Sequence[str],
        stats: str | None,
        frames: Ends | None,
        shot: bool,
        layers: tuple[str, ...] = (),
    ) -> FrameNames:
        """Split what was asked for, as `split` does. Raises OutputError as `check_patterns` does."""
        check_patterns(outputs, stats, frames, shot)
        return cls.split(outputs, stats, shot, layers)

    def of(self, frame: int | None) -> list[str]:
        """The pictures that a frame has for its own."""
        return [path_of(pattern, frame) for pattern in self.single]

    def layers_of(self, frame: int | None) -> list[LayerFile]:
        """The files that a frame's layers have for their own."""
        return layer_files(self.of(frame), self.layers)

    def stats_of(self, frame: int | None) -> str | None:
        """Where the statistics of a frame go."""
        return None if self.stats is None else path_of(self.stats, frame)

    def every(self, frames: Iterable[int | None]) -> Iterator[str]:
        """All files of these frames that are written."""
        yield from self.played
        for frame in frames:
            yield from self.of(frame)
            yield from (file.path for file in self.layers_of(frame))
            if self.stats is not None:
                yield path_of(self.stats, frame)


class _Animated(Protocol):
    @property
    def frames(self) -> int: ...


class _Scene(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def shot(self) -> _Animated | None: ...


def longest_number(frames: Ends | None) -> int:
    """The number of the frame whose names are looked at before the work, for all: none is longer. None: all frames."""
    return LONGEST_NUMBER if frames is None else frames[1]


def frames_of(scene: _Scene, frames: Ends | None) -> range:
    """The numbers of the frames of a shot that are asked for, None: of all. Raises SceneError for those it has not."""
    if scene.shot is None:
        raise SceneError(f"{scene.name}: nothing moves in the scene, wanted keys in it, or --turntable N")
    first, last = frames or (1, scene.shot.frames)
    if not 1 <= first <= last <= scene.shot.frames:
        came = f"frame {first}" if first == last else f"frames {first}-{last}"
        raise SceneError(f"{scene.name}: {came} came, wanted frames of 1 to {scene.shot.frames}")
    return range(first, last + 1)


def default_outputs(scene: str, shot: bool) -> tuple[str, ...]:
    """A .png of the scene's name, in the current directory; of a shot numbered ones."""
    return (pattern_of(Path(scene).stem) + ("_%04d.png" if shot else ".png"),)


@dataclass(frozen=True)
class Turntable:
    """How many frames a turn has, and whether the scene turns and not the camera."""

    frames: int
    turn_scene: bool


def turntable_of(camera: int | None, scene: int | None) -> Turntable | None:
    """The turntable that was asked for. Raises SceneMisuse if both were."""
    if camera is not None and scene is not None:
        raise SceneMisuse("--turntable and --turntable-scene came, wanted one of them")
    frames = scene if camera is None else camera
    return None if frames is None else Turntable(int(frames), scene is not None)
