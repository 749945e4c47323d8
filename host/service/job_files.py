"""The files of a frame that a service renders: their names, whether they are there already, and the writing of them.

Frames of files that play wait in the state directory of the array until the last of the job is done, so that a job
which is taken up after a crash goes on where it was.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from raygrid.host.client.facts import ENDED
from raygrid.host.files.input_guard import Inputs, check_outputs
from raygrid.host.image.frames import is_played, path_of
from raygrid.host.image.moving_pictures import Reel, check_played, padding
from raygrid.host.image.outputs import check_named, check_picture_path, check_side, suffix_of
from raygrid.host.image.resume_check import Recorded, film_is_there, frame_is_there, save_marked
from raygrid.host.render.stats import save_stats
from raygrid.node.errors import OutputError, RaygridError

if TYPE_CHECKING:
    from raygrid.host.client.requests import SubmitMessage
    from raygrid.host.image.picture import Picture
    from raygrid.host.journal.journal import Journal
    from raygrid.host.service.scene_store import PreparedFrame

Files = dict[str, str]


class JobFiles:
    """The files of one frame of a job; those that hold all frames are made of what waits in its reel.

    single  those of this frame alone; stats: its statistics, or None
    played  those that hold all frames
    """

    def __init__(self, request: SubmitMessage, frame: int | None, ready: PreparedFrame, reel: Reel) -> None:
        shot = request.frames is not None
        self._request, self._frame, self._ready = request, frame, ready
        self._reel = reel
        played = [pattern for pattern in request.outputs if is_played(pattern, shot)]
        self._patterns = [pattern for pattern in request.outputs if pattern not in played]
        self.single = [path_of(pattern, frame) for pattern in self._patterns]
        self.stats = None if request.stats is None else path_of(request.stats, frame)
        self.played = [path_of(pattern, None) for pattern in played]
        self._digest = ready.digest(frame, request.transfer)
        self._size = ready.job.frame.width, ready.job.frame.height

    @property
    def digests(self) -> Files:
        """The digest of each file of this frame alone."""
        return dict.fromkeys(self.single, self._digest)

    @property
    def remarks(self) -> list[str]:
        """What is to be said of them."""
        found = (padding(path, *self._size) for path in self.played)
        return [remark for remark in found if remark is not None]

    def note(self, inputs: Inputs) -> None:
        """Note what the frame is made of: no output may be one of these."""
        inputs.add(self._request.scene, "the same file as the scene")
        if self._request.program is not None:
            inputs.add(self._request.program, "the same file as the program")
        for path in self._ready.files:
            inputs.add(path, "a file that the scene is made of")

    def check_all(self) -> None:
        """Raise OutputError if any file of the job, of whichever frame, is one that is read, or comes twice."""
        if len(self.played) > len(set(self.played)):
            raise OutputError(f"{self.played[0]}: the output came twice, wanted it once")
        check_outputs(self._every())

    def _every(self) -> Iterator[str]:
        frames = self._request.frames
        yield from self.played
        for number in [None] if frames is None else range(frames[0], frames[1] + 1):
            yield from (path_of(pattern, number) for pattern in self._patterns)
            if self._request.stats is not None:
                yield path_of(self._request.stats, number)

    def check(self) -> None:
        """Raise OutputError if the frame can surely not be written."""
        for file in self.single:
            check_picture_path(file)
        for file in self.played:
            check_played(file)
        for file in (*self.single, *self.played):
            check_side(file, *self._size)
        if self.stats is not None:
            check_named(self.stats)

    def are_there(self, recorded: Recorded) -> bool:
        """Whether the frame need not be rendered, as its files are there; if it is to play, it then waits, too."""
        if not frame_is_there(self.single, self.stats, self._digest, self._size, recorded):
            return False
        if not self.played or all(film_is_there(path, self._film_digest, recorded) for path in self.played):
            return True
        pictures = [file for file in self.single if suffix_of(file) == ".png"]
        if pictures and self._frame is not None:
            self._make_folder()
            self._reel.take(self._frame, pictures[0])
        return bool(pictures)

    def write(self, picture: Picture) -> None:
        """Write the frame. Raises OutputError."""
        for file in self.single:
            save_marked(picture, file, self._request.transfer, self._digest)
        if self.stats is not None:
            save_stats(self.stats, picture.stats)
        if self.played and self._frame is not None:
            self.keep(self._frame, picture)

    def missing(self, recorded: Recorded) -> list[str]:
        """The files that hold all frames and are not there."""
        if not self.played or self._request.frames is None or self._ready.job.scene.shot is None:
            return []
        resumed = recorded if self._request.resume else lambda _path, _digest: False
        return [path for path in self.played if not film_is_there(path, self._film_digest, resumed)]

    def lacking(self, recorded: Recorded) -> list[int]:
        """The frames that are wanted to be played and wait no more, since somebody has removed them."""
        return [number for number in self._numbers if not self._reel.has(number)] if self.missing(recorded) else []

    def play(self, recorded: Recorded) -> Files:
        """Write the files that hold all frames, if they are not there; returns them with their digests."""
        missing, shot = self.missing(recorded), self._ready.job.scene.shot
        for path in missing:
            assert shot is not None
            self._reel.play(path, self._numbers, shot.fps)
        return dict.fromkeys(missing, self._film_digest)

    @property
    def _numbers(self) -> range:
        first, last = self._request.frames or (1, 0)
        return range(first, last + 1)

    def keep(self, number: int, picture: Picture) -> None:
        """Let a frame wait to be played. Raises OutputError."""
        self._make_folder()
        self._reel.add(number, picture.bytes(self._request.transfer))

    @property
    def _film_digest(self) -> str:
        return self._ready.digest(self._request.frames, self._request.transfer)

    def _make_folder(self) -> None:
        try:
            os.makedirs(self._reel.folder, mode=0o700, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{self._reel.folder}: frames cannot be kept there ({error.strerror})") from None


def sweep_films(folder: Path, journal: Journal) -> None:
    """Remove the frames that wait for jobs which have ended. Never raises OSError nor OutputError."""
    with contextlib.suppress(OSError, RaygridError):
        for name in os.listdir(folder):
            row = journal.find(int(name)) if name.isdecimal() else None
            if row is None or row.state in ENDED:
                shutil.rmtree(folder / name, ignore_errors=True)
