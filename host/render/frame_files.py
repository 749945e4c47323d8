"""Writes the files of one frame, or finds that they are there already."""

from __future__ import annotations

from raygrid.host.image.frames import FrameNames
from raygrid.host.image.layer_names import HOLDS_LAYERS
from raygrid.host.image.moving_pictures import Reel
from raygrid.host.image.outputs import suffix_of
from raygrid.host.image.picture import Picture
from raygrid.host.image.resume_check import (
    Recorded,
    digest_of_layers,
    frame_is_there,
    nobody,
    save_marked,
    save_marked_layer,
)
from raygrid.host.render.prepared import PreparedFrame
from raygrid.host.render.stats import save_stats


class FrameFiles:
    """The files of one frame of a job; those that hold all frames are made of what waits in a reel.

    names   of all files of the job
    frame   number of the frame, or None: files without one
    reel    where frames wait for the files that hold all
    single  the files of this frame alone; layers: those of its layers; stats: its statistics, or None
    digest  of all that a picture of this frame depends on
    """

    def __init__(self, names: FrameNames, frame: int | None, ready: PreparedFrame, transfer: str, reel: Reel) -> None:
        self.names, self.frame, self.ready, self.transfer, self.reel = names, frame, ready, transfer, reel
        self.single, self.layers, self.stats = names.of(frame), names.layers_of(frame), names.stats_of(frame)
        self.digest = ready.digest(frame, transfer)

    def are_there(self, recorded: Recorded = nobody) -> bool:
        """Whether the frame need not be rendered, as its files are there; if it is to play, it then waits, too.

        recorded  as of `raygrid.host.image.resume_check.is_whole`
        """
        files = [(path, self._digest_of(path)) for path in self.single]
        files += [(path, digest_of_layers(self.digest, layer)) for path, layer in self.layers]
        if not frame_is_there(files, self.stats, self.ready.size, recorded):
            return False
        if self.all_played(recorded):
            return True
        pictures = [file for file in self.single if suffix_of(file) == ".png"]
        if pictures and self.frame is not None:
            self.waiting().take(self.frame, pictures[0])
        return bool(pictures)

    def _digest_of(self, path: str) -> str:
        """Of all that a file of the picture depends on: one that holds layers depends on which."""
        layers = self.ready.job.settings.layers if suffix_of(path) == HOLDS_LAYERS else ()
        return digest_of_layers(self.digest, *layers) if layers else self.digest

    def all_played(self, _recorded: Recorded) -> bool:
        """Whether no file that holds all frames wants this one."""
        return not self.names.played

    def write(self, picture: Picture) -> None:
        """Write the frame. Raises OutputError."""
        for file in self.single:
            save_marked(picture, file, self.transfer, self._digest_of(file))
        for layer in self.layers:
            save_marked_layer(picture, layer, self.digest)
        if self.stats is not None:
            save_stats(self.stats, picture.stats)
        if self.names.played and self.frame is not None:
            self.keep(self.frame, picture)

    def keep(self, number: int, picture: Picture) -> None:
        """Let a frame wait to be played. Raises OutputError."""
        self.waiting().add(number, picture.bytes(self.transfer))

    def waiting(self) -> Reel:
        """Where frames wait, made ready. Raises OutputError."""
        return self.reel
