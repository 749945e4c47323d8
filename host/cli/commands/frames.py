"""The command `raygrid render` for several frames: of a shot, or of a turntable."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from raygrid.emulator.processes import Array
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.files.input_guard import check_outputs
from raygrid.host.files.part_files import sweep_folders
from raygrid.host.image.frames import check_patterns, frames_of, is_played, path_of
from raygrid.host.image.moving_pictures import Reel, check_played, padding, waiting
from raygrid.host.image.outputs import check_named, check_picture_path, check_side, suffix_of, write_result
from raygrid.host.scene.load import check_name
from raygrid.host.text.misuse import OutputMisuse

if TYPE_CHECKING:
    from raygrid.host.cli.commands.render import RenderRequest
    from raygrid.host.image.picture import Picture
    from raygrid.host.render.job import Job
    from raygrid.host.scene.scene import Scene

LARGEST_NUMBER = 1_000_000


@dataclass
class _Files:
    """What is written of a shot.

    single  patterns of files that each frame has; played: files that hold all frames
    reel    where frames for those wait
    written the files that were written
    blank   what is to be said of pictures that show nothing -> numbers of their frames
    """

    request: RenderRequest
    single: list[str]
    played: list[str]
    contents: str = ""
    reel: Reel | None = None
    written: list[str] = field(default_factory=list)
    blank: dict[str, list[int]] = field(default_factory=dict)

    def of(self, number: int) -> list[str]:
        """A frame's own files."""
        return [path_of(pattern, number) for pattern in self.single]

    def stats(self, number: int) -> str | None:
        """A frame's statistics."""
        return None if self.request.stats is None else path_of(self.request.stats, number)

    def digest(self, job: Job) -> str:
        """A digest of all that a frame depends on."""
        from raygrid.host.render.picture_digest import picture_digest

        return picture_digest(self.contents, job.settings, job.number, self.request.transfer)

    def are_there(self, job: Job) -> bool:
        """Whether a frame need not be rendered, as its files are there; the reel then has it, too."""
        from raygrid.host.image.resume_check import frame_is_there

        number = int(job.number or 0)
        files = self.of(number)
        pictures = [file for file in files if suffix_of(file) == ".png"]
        if not files or (self.reel is not None and not pictures):
            return False
        size = job.frame.width, job.frame.height
        if not frame_is_there(files, self.stats(number), self.digest(job), size):
            return False
        if self.reel is not None:
            self.reel.take(number, pictures[0])
        return True

    def save(self, job: Job, picture: Picture) -> None:
        """Write a frame's own files."""
        from raygrid.host.image.resume_check import save_marked
        from raygrid.host.render.stats import save_stats

        number, transfer, digest = int(job.number or 0), self.request.transfer, self.digest(job)
        if (said := picture.blank()) is not None:
            self.blank.setdefault(said, []).append(number)
        for path in self.of(number):
            save_marked(picture, path, transfer, digest)
            self.written.append(path)
        stats = self.stats(number)
        if stats is not None:
            save_stats(stats, picture.stats)
        if self.reel is not None:
            self.reel.add(number, picture.bytes(transfer))


def as_ranges(frames: list[int]) -> str:
    """Ascending numbers of frames, in words: "frames 3-5, 9"."""
    ranges: list[list[int]] = []
    for number in frames:
        if ranges and number == ranges[-1][-1] + 1:
            ranges[-1][1:] = [number]
        else:
            ranges.append([number])
    return f"frame{'s' * (len(frames) > 1)} {', '.join('-'.join(map(str, each)) for each in ranges)}"


def run_frames(request: RenderRequest) -> None:
    """Launch, read, and for each frame load or increment, trace, collect, write. Raises RaygridError."""
    from raygrid.host.cli.commands.render import launching

    begun = time.perf_counter()
    check_name(request.scene)
    files = _check_names(request)
    sweep_folders()
    with ProgressReporter(request.quiet, request.program is not None) as reporter, contextlib.ExitStack() as stack:
        if files.played:
            files.reel = stack.enter_context(waiting())
        with launching(request, reporter) as array:
            array.begin()
            reporter.phase(f"reading {request.scene}")
            scene, numbers = _read(files, reporter)
            rate, skipped = _render(files, scene, numbers, array, reporter)
            reporter.phase("ending the processors")
        for said, frames in files.blank.items():
            reporter.remark(f"{as_ranges(frames)}: {said}")
        for path in files.played:
            reporter.phase(f"writing {path}")
            assert files.reel is not None
            files.reel.play(path, numbers, 1.0 if scene.shot is None else scene.shot.fps)
        if skipped:
            reporter.remark(f"{skipped} of {len(numbers)} frames were there already")
        reporter.say(
            f"{len(numbers) - skipped} frames, traced in {rate:.2f} s of wall time, {time.perf_counter() - begun:.2f} s in all"
        )
    for output in (*files.written, *files.played):
        write_result(output)


def _check_names(request: RenderRequest) -> _Files:
    """The files of the shot. Raises OutputError for those that cannot be, before the work."""
    from raygrid.host.cli.commands.render import note_read

    check_patterns(request.outputs, request.stats, request.frames, True)
    single = [pattern for pattern in request.outputs if not is_played(pattern, True)]
    played = [path_of(pattern, None) for pattern in request.outputs if is_played(pattern, True)]
    for output in played:
        check_played(output)
    largest = LARGEST_NUMBER if request.frames is None else request.frames[1]
    for output in single:
        check_named(path_of(output, largest))
        check_picture_path(path_of(output, largest))
    if request.stats is not None:
        check_named(path_of(request.stats, largest))
    if len(played) > len(set(played)):
        raise OutputMisuse(f"{played[0]}: the output came twice, wanted it once")
    files = _Files(request, single, played)
    note_read(request)
    check_outputs(_paths(files, [largest]))
    return files


def _paths(files: _Files, numbers: list[int]) -> Iterator[str]:
    """All files that are to be written."""
    yield from files.played
    for number in numbers:
        yield from files.of(number)
        stats = files.stats(number)
        if stats is not None:
            yield stats


def _read(files: _Files, reporter: ProgressReporter) -> tuple[Scene, list[int]]:
    """The shot, and the numbers of its frames that are to be rendered."""
    from raygrid.host.render.picture_digest import contents_of_shot
    from raygrid.host.scene.load import load_scene
    from raygrid.host.scene.sources import recorded

    request = files.request
    with recorded() as sources:
        scene = load_scene(request.scene)
    for remark in scene.remarks:
        reporter.remark(remark)
    files.contents = contents_of_shot(sources, request.turntable)
    if request.turntable is not None:
        from raygrid.host.scene.animation.turntable import turntable

        scene = turntable(scene, request.turntable.frames, request.turntable.turn_scene)
    numbers = list(frames_of(scene, request.frames))
    check_outputs(_paths(files, numbers))  # now that all is read
    return scene, numbers


def _render(
    files: _Files, scene: Scene, numbers: list[int], array: Array, reporter: ProgressReporter
) -> tuple[float, int]:
    """Render each frame that is not there yet, and write it; seconds of tracing, and how many were there."""
    from raygrid.host.cli.commands.render import program_of
    from raygrid.host.render.animation_jobs import jobs_of
    from raygrid.host.render.job import Settings, samples_expected
    from raygrid.host.render.session import RenderSession

    request = files.request
    settings = Settings(**request.settings, program=program_of(request))
    session = RenderSession(array, request.attempts, reporter.fault)
    rate, skipped = 0.0, 0
    for done, job in enumerate(jobs_of(scene, request.shape, settings, numbers, array.wait_warm)):
        if done == 0:
            _begin(files, job, reporter)
            array.wait_ready()
            reporter.shot(len(numbers))
        reporter.frame(numbers[done], done, skipped)
        if request.resume and files.are_there(job):
            skipped += 1
            continue
        reporter.expect(samples_expected(job))
        picture = session.render(job, request.budget, reporter.watch)
        reporter.phase("writing")
        files.save(job, picture)
        rate += picture.stats["wall_seconds"]["trace"]
    reporter.shot(0)
    return rate, skipped


def _begin(files: _Files, job: Job, reporter: ProgressReporter) -> None:
    """What can be said once the first frame's size is known. Raises OutputError."""
    for output in files.request.outputs:
        check_side(output, job.frame.width, job.frame.height)
        padded = padding(output, job.frame.width, job.frame.height)
        if padded is not None:
            reporter.remark(padded)
    reporter.phase("launching the processors")
