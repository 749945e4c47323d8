"""Looks at and writes the files of a frame that a service renders.

Frames of files that play wait in the state directory of the array until the last of the job is done, so that a job
which is taken up after a crash goes on where it was.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from raygrid.host.client.facts import ENDED
from raygrid.host.files.input_guard import Inputs, check_outputs
from raygrid.host.image.frames import FrameNames
from raygrid.host.image.moving_pictures import Reel, check_played, padding
from raygrid.host.image.outputs import check_named, check_picture_path, check_side
from raygrid.host.image.resume_check import Recorded, film_is_there
from raygrid.host.render.frame_files import FrameFiles
from raygrid.node.errors import OutputError, RaygridError

if TYPE_CHECKING:
    from raygrid.host.client.requests import SubmitMessage
    from raygrid.host.journal.journal import Journal
    from raygrid.host.render.prepared import PreparedFrame

Files = dict[str, str]


class JobFiles(FrameFiles):
    """The files of one frame of a job of the service, for which the journal vouches."""

    def __init__(self, request: SubmitMessage, frame: int | None, ready: PreparedFrame, reel: Reel) -> None:
        names = FrameNames.split(request.outputs, request.stats, request.frames is not None)
        super().__init__(names, frame, ready, request.transfer, reel)
        self._request = request
        self._film_digest = ready.digest(request.frames, request.transfer)

    @property
    def digests(self) -> Files:
        """The digest of each file of this frame alone."""
        return dict.fromkeys(self.single, self.digest)

    @property
    def remarks(self) -> list[str]:
        """What is to be said of them."""
        found = (padding(path, *self.ready.size) for path in self.names.played)
        return [remark for remark in found if remark is not None]

    def note(self, inputs: Inputs) -> None:
        """Note what the frame is made of: no output may be one of these."""
        inputs.add(self._request.scene, "the same file as the scene")
        if self._request.program is not None:
            inputs.add(self._request.program, "the same file as the program")
        for path in self.ready.files:
            inputs.add(path, "a file that the scene is made of")

    def check_all(self) -> None:
        """Raise OutputError if any file of the job, of whichever frame, is one that is read, or comes twice."""
        played, frames = self.names.played, self._request.frames
        if len(played) > len(set(played)):
            raise OutputError(f"{played[0]}: the output came twice, wanted it once")
        check_outputs(self.names.every([None] if frames is None else self._numbers))

    def check(self) -> None:
        """Raise OutputError if the frame can surely not be written."""
        for file in self.single:
            check_picture_path(file)
        for file in self.names.played:
            check_played(file)
        for file in (*self.single, *self.names.played):
            check_side(file, *self.ready.size)
        if self.stats is not None:
            check_named(self.stats)

    def all_played(self, recorded: Recorded) -> bool:
        """Whether all files that hold all frames are there."""
        return all(film_is_there(path, self._film_digest, recorded) for path in self.names.played)

    def missing(self, recorded: Recorded) -> list[str]:
        """The files that hold all frames and are not there."""
        if self._request.frames is None or self.ready.job.scene.shot is None:
            return []
        resumed = recorded if self._request.resume else lambda _path, _digest: False
        return [path for path in self.names.played if not film_is_there(path, self._film_digest, resumed)]

    def lacking(self, recorded: Recorded) -> list[int]:
        """The frames that are wanted to be played and wait no more, since somebody has removed them."""
        return [number for number in self._numbers if not self.reel.has(number)] if self.missing(recorded) else []

    def play(self, recorded: Recorded) -> Files:
        """Write the files that hold all frames, if they are not there; returns them with their digests."""
        missing, shot = self.missing(recorded), self.ready.job.scene.shot
        for path in missing:
            assert shot is not None
            self.reel.play(path, self._numbers, shot.fps)
        return dict.fromkeys(missing, self._film_digest)

    @property
    def _numbers(self) -> range:
        first, last = self._request.frames or (1, 0)
        return range(first, last + 1)

    def waiting(self) -> Reel:
        """Where frames wait, in a folder that is made. Raises OutputError."""
        reel = super().waiting()
        try:
            os.makedirs(reel.folder, mode=0o700, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{reel.folder}: frames cannot be kept there ({error.strerror})") from None
        return reel


def sweep_films(folder: Path, journal: Journal) -> None:
    """Remove the frames that wait for jobs which have ended. Never raises OSError nor OutputError."""
    with contextlib.suppress(OSError, RaygridError):
        for name in os.listdir(folder):
            row = journal.find(int(name)) if name.isdecimal() else None
            if row is None or row.state in ENDED:
                shutil.rmtree(folder / name, ignore_errors=True)
