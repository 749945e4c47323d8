"""The command `raygrid render` for several frames: of a shot, or of a turntable."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from raygrid.emulator.array import Array
from raygrid.host.load import check_name
from raygrid.host.misuse import OutputMisuse
from raygrid.host.moving_pictures import PLAYED, Reel, check_played
from raygrid.host.outputs import check_different, check_path, check_picture_path, check_side, write_result
from raygrid.host.progress import Talk
from raygrid.node.errors import SceneError

if TYPE_CHECKING:
    from raygrid.host.command_render import Request
    from raygrid.host.picture import Picture
    from raygrid.host.scene import Scene

NUMBER = re.compile(r"%(0?[1-9])?d")
LARGEST_NUMBER = 1_000_000


def has_number(path: str) -> bool:
    """Whether a name has a place for the number of a frame, such as %04d. Raises OutputMisuse for any other %."""
    places = NUMBER.findall(path)
    if len(places) > 1 or NUMBER.sub("", path).count("%"):
        raise OutputMisuse(f"{path}: the output has a % in its name that is no number, wanted one such as %04d")
    return bool(places)


def named(path: str, frame: int) -> str:
    """The file of a frame."""
    return NUMBER.sub(lambda place: place.group(0) % frame, path)


def is_played(path: str) -> bool:
    """Whether one file holds all frames."""
    return Path(path).suffix.lower() in PLAYED and not has_number(path)


def wants_frames(request: Request) -> bool:
    """Whether more than one picture of the scene as it stands is asked for."""
    named_so = any(NUMBER.search(path) or Path(path).suffix.lower() in (".gif", ".mp4") for path in request.outputs)
    return request.frames is not None or request.turntable is not None or named_so


def as_ranges(frames: list[int]) -> str:
    """Ascending numbers of frames, in words: "frames 3-5, 9"."""
    ranges: list[list[int]] = []
    for number in frames:
        if ranges and number == ranges[-1][-1] + 1:
            ranges[-1][1:] = [number]
        else:
            ranges.append([number])
    return f"frame{'s' * (len(frames) > 1)} {', '.join('-'.join(map(str, each)) for each in ranges)}"


def run_frames(request: Request) -> None:
    """Launch, read, and for each frame load or increment, trace, collect, write. Raises RaygridError."""
    from raygrid.host.command_render import launching

    begun = time.perf_counter()
    check_name(request.scene)
    _check_names(request)
    written: list[str] = []
    with Talk(request.quiet) as talk, contextlib.ExitStack() as reels:
        played = [output for output in request.outputs if is_played(output)]
        with launching(request, talk) as array:
            array.begin()
            talk.phase(f"reading {request.scene}")
            scene, numbers = _read(request, talk)
            fps = scene.shot.fps if scene.shot is not None else 1.0
            files = [reels.enter_context(Reel(output, fps)) for output in played]
            rate = 0.0
            blank: dict[str, list[int]] = {}
            for picture, number in _pictures(request, scene, numbers, array, talk):
                talk.phase(f"writing frame {number}")
                written += _save(request, picture, number)
                for file in files:
                    file.add(picture.bytes(request.transfer))
                rate += picture.stats["wall_seconds"]["trace"]
                if (said := picture.blank()) is not None:
                    blank.setdefault(said, []).append(number)
            talk.phase("ending the processors")
        for said, frames in blank.items():
            talk.remark(f"{as_ranges(frames)}: {said}")
        for file in files:
            talk.phase(f"writing {file.path}")
            file.write()
        written += played
        talk.say(
            f"{len(numbers)} frames, traced in {rate:.2f} s of wall time, {time.perf_counter() - begun:.2f} s in all"
        )
    for output in written:
        write_result(output)


def _check_names(request: Request) -> None:
    """Raise OutputMisuse for outputs that cannot be, before the work."""
    for output in request.outputs:
        if is_played(output):
            check_played(output)
        elif has_number(output):
            check_picture_path(named(output, LARGEST_NUMBER))
        elif request.frames is None or request.frames[0] != request.frames[1]:
            raise OutputMisuse(
                f"{output}: several frames would go to this one file, wanted a number such as %04d in its name, "
                f"or one of: {' '.join(PLAYED)}"
            )
        else:
            check_picture_path(output)
    outputs = list(request.outputs)
    if request.stats is not None:
        check_path(named(request.stats, LARGEST_NUMBER))
        outputs.append(request.stats)
        if not has_number(request.stats) and (request.frames is None or request.frames[0] != request.frames[1]):
            raise OutputMisuse(
                f"{request.stats}: statistics of several frames came, wanted a number such as %04d in the name"
            )
    check_different(request.scene, outputs)


def _read(request: Request, talk: Talk) -> tuple[Scene, list[int]]:
    """The shot, and the numbers of its frames that are to be rendered."""
    from raygrid.host.load import load_scene

    scene = load_scene(request.scene)
    for remark in scene.remarks:
        talk.remark(remark)
    if request.turntable is not None:
        from raygrid.host.turntable import turntable

        scene = turntable(scene, request.turntable.frames, request.turntable.turn_scene)
    if scene.shot is None:
        raise SceneError(f"{scene.name}: nothing moves in the scene, wanted keys in it, or --turntable N")
    first, last = request.frames or (1, scene.shot.frames)
    if last > scene.shot.frames:
        raise SceneError(f"{scene.name}: frames {first}-{last} came, wanted frames of 1 to {scene.shot.frames}")
    return scene, list(range(first, last + 1))


def _pictures(
    request: Request, scene: Scene, numbers: list[int], array: Array, talk: Talk
) -> Iterator[tuple[Picture, int]]:
    """Each frame's picture and number, one after the other."""
    from raygrid.host.command_render import program_of
    from raygrid.host.job import Settings, samples_expected
    from raygrid.host.shot_jobs import jobs_of
    from raygrid.host.steady import render_steadily

    settings = Settings(**request.settings, program=program_of(request))
    jobs = jobs_of(scene, request.shape, settings, numbers, array.wait_warm)
    for job in jobs:
        if job.number == numbers[0]:
            for output in request.outputs:
                check_side(output, job.frame.width, job.frame.height)
            talk.phase("launching the processors")
            array.wait_ready()
        talk.of(f"frame {job.number} of {numbers[-1]}: ")
        talk.expect(samples_expected(job))
        picture = render_steadily(
            array, job, request.budget, talk.watch, attempts=request.attempts, on_fault=talk.fault
        )
        yield picture, int(job.number or 0)
        talk.of("")


def _save(request: Request, picture: Picture, number: int) -> list[str]:
    """Write a frame's own files; returns their names."""
    paths = [named(output, number) for output in request.outputs if not is_played(output)]
    for path in paths:
        picture.save(path, request.transfer)
    if request.stats is not None:
        from raygrid.host.stats import save_stats

        save_stats(named(request.stats, number), picture.stats)
    return paths
