"""Frames of a job: their numbers, the names of their files, and how each is made of the scene. Light to import."""

from __future__ import annotations

import re
from dataclasses import dataclass

from raygrid.host.misuse import OutputMisuse, SceneMisuse

FIELD = re.compile(r"%(0?[0-9]?)d")
LAST_FRAME = 999_999_999
MOST_FRAMES = 100_000  # of a job


def parse_frames(text: str) -> tuple[int, int]:
    """First and last frame of "A-B", or of "A" alone. Raises ValueError, saying what was wanted."""
    found = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9}))?", text)
    if found is None:
        raise ValueError("wanted frames such as 1-250, or one such as 7")
    first, last = int(found[1]), int(found[2] or found[1])
    if not first <= last < first + MOST_FRAMES:
        raise ValueError(f"wanted the first frame not after the last, and at most {MOST_FRAMES} of them")
    return first, last


def check_pattern(pattern: str, frames: tuple[int, int] | None) -> None:
    """Raise OutputMisuse if the files of several frames would have one name, or the number has more than one place."""
    if frames is None:
        return
    fields = len(FIELD.findall(pattern))
    if fields > 1 or (fields == 0 and frames[0] != frames[1]):
        came = f"{fields} places" if fields else "no place"
        raise OutputMisuse(f"{pattern}: the output has {came} for the frame's number, wanted one, such as f_%04d.png")


def path_of(pattern: str, frame: int | None) -> str:
    """The file of a frame; the pattern as it is if the job names no frames."""
    if frame is None:
        return pattern
    return FIELD.sub(lambda field: f"{frame:{field[1]}d}", pattern)


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
