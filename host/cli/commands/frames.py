"""Renders several frames for `raygrid render`: of an animation, or of a turntable."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from raygrid.emulator.processes import Array
from raygrid.host.cli.commands.render_request import RenderRequest
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.files.input_guard import check_outputs
from raygrid.host.files.part_files import sweep_folders
from raygrid.host.image.frames import FrameNames, frames_of, longest_number, path_of
from raygrid.host.image.moving_pictures import Reel, check_played, padding, waiting
from raygrid.host.image.outputs import check_named, check_picture_path, check_side, write_result
from raygrid.host.scene.load import check_name
from raygrid.host.scene.view import view_of
from raygrid.host.text.misuse import OutputMisuse

if TYPE_CHECKING:
    from raygrid.host.image.picture import Picture
    from raygrid.host.render.frame_files import FrameFiles
    from raygrid.host.scene.scene import Scene


class _AskedFrames(NamedTuple):
    """Frames of an animation: the scene on its turntable if it has one, a digest of its files, and their numbers."""

    scene: Scene
    contents: str
    numbers: list[int]


@dataclass
class _Outcome:
    """What became of the frames.

    traced   seconds of wall time
    skipped  how many were there already
    written  the files that were written
    blank    what is to be said of pictures that show nothing -> numbers of their frames
    """

    traced: float = 0.0
    skipped: int = 0
    written: list[str] = field(default_factory=list)
    blank: dict[str, list[int]] = field(default_factory=dict)

    def write(self, files: FrameFiles, picture: Picture) -> None:
        """Write a frame's own files."""
        if (said := picture.blank()) is not None:
            self.blank.setdefault(said, []).append(int(files.frame or 0))
        files.write(picture)
        self.written += [*files.single, *(file for file, _ in files.layers)]
        self.traced += picture.stats["wall_seconds"]["trace"]


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
    begun = time.perf_counter()
    check_name(request.scene)
    view_of(request.view)
    names = _check_names(request)
    sweep_folders()
    with ProgressReporter(request.quiet, request.program is not None) as reporter, contextlib.ExitStack() as stack:
        reel = stack.enter_context(waiting()) if names.played else Reel("")  # where nothing waits
        with request.launching(reporter) as array:
            array.begin()
            reporter.phase(f"reading {request.scene}")
            asked = _read(request, names, reporter)
            outcome = _render(request, asked, reel, array, reporter)
            reporter.phase("ending the processors")
        for said, frames in outcome.blank.items():
            reporter.remark(f"{as_ranges(frames)}: {said}")
        for path in names.played:
            reporter.phase(f"writing {path}")
            reel.play(path, asked.numbers, 1.0 if asked.scene.shot is None else asked.scene.shot.fps)
        many, skipped = len(asked.numbers), outcome.skipped
        if skipped:
            reporter.remark(f"{skipped} of {many} frames were there already")
        spent = time.perf_counter() - begun
        reporter.say(f"{many - skipped} frames, traced in {outcome.traced:.2f} s of wall time, {spent:.2f} s in all")
    for output in (*outcome.written, *names.played):
        write_result(output)


def _check_names(request: RenderRequest) -> FrameNames:
    """The names of the files. Raises OutputError for those that cannot be, before the work."""
    names = request.names
    for output in names.played:
        check_played(output)
    longest = longest_number(request.frames)
    for output in names.of(longest):
        check_named(output)
        check_picture_path(output)
    for file, _ in names.layers_of(longest):
        check_named(file)
    if names.stats is not None:
        check_named(path_of(names.stats, longest))
    if len(names.played) > len(set(names.played)):
        raise OutputMisuse(f"{names.played[0]}: the output came twice, wanted it once")
    request.note_read()
    check_outputs(names.every([longest]))
    return names


def _read(request: RenderRequest, names: FrameNames, reporter: ProgressReporter) -> _AskedFrames:
    """Read the scene, and which of its frames are to be rendered. Raises SceneError, OutputError."""
    from raygrid.host.render.prepared import contents_of_shot, turned
    from raygrid.host.scene.load import load_scene
    from raygrid.host.scene.sources import recorded

    with recorded() as sources:
        scene = load_scene(request.scene, **request.view)
    for remark in scene.remarks:
        reporter.remark(remark)
    contents = contents_of_shot(sources, request.turntable, view_of(request.view))
    scene = turned(scene, request.turntable)
    numbers = list(frames_of(scene, request.frames))
    check_outputs(names.every(numbers))  # now that all is read
    return _AskedFrames(scene, contents, numbers)


def _render(
    request: RenderRequest, asked: _AskedFrames, reel: Reel, array: Array, reporter: ProgressReporter
) -> _Outcome:
    """Render each frame that is not there yet, and write it."""
    from raygrid.host.render.animation_jobs import jobs_of
    from raygrid.host.render.frame_files import FrameFiles
    from raygrid.host.render.job import samples_expected
    from raygrid.host.render.prepared import PreparedFrame
    from raygrid.host.render.session import RenderSession

    settings, names, outcome = request.read_settings(), request.names, _Outcome()
    session = RenderSession(array, request.attempts, reporter.fault)
    for done, job in enumerate(jobs_of(asked.scene, request.shape, settings, asked.numbers, array.wait_warm)):
        files = FrameFiles(names, job.number, PreparedFrame(job, asked.contents), request.transfer, reel)
        if done == 0:
            _begin(request, files, reporter)
            array.wait_ready()
            reporter.shot(len(asked.numbers))
        reporter.frame(asked.numbers[done], done, outcome.skipped)
        if request.resume and files.are_there():
            outcome.skipped += 1
            continue
        reporter.expect(samples_expected(job))
        picture = session.render(job, request.budget, reporter.watch)
        reporter.phase("writing")
        outcome.write(files, picture)
    reporter.shot(0)
    return outcome


def _begin(request: RenderRequest, files: FrameFiles, reporter: ProgressReporter) -> None:
    """What can be said once the first frame's size is known. Raises OutputError."""
    for output in request.outputs:
        check_side(output, *files.ready.size)
        padded = padding(output, *files.ready.size)
        if padded is not None:
            reporter.remark(padded)
    reporter.phase("launching the processors")
