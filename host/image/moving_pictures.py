"""Writes files that play: GIF and WebP by Pillow, MP4 by ffmpeg (`host.image.ffmpeg`).

The frames of a file wait as PNGs in a directory, so that a long animation does not fill the memory; the file itself appears
whole or not at all.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, BinaryIO

from raygrid.host.files.input_guard import check_kept
from raygrid.host.files.part_files import PartFolder, replacing
from raygrid.host.image.ffmpeg import need_ffmpeg
from raygrid.host.image.outputs import check_named, suffix_of, write_whole
from raygrid.node.errors import OutputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL.Image import Image

GIF_TICK = 10  # milliseconds; a GIF counts in these, and players take fewer than two of them for ten
FFMPEG_SECONDS = 60.0  # for it to end, once it has all frames; and a second more for each of them
LOOK_SECONDS = 0.1
QUIETLY = ["-nostdin", "-loglevel", "error"]


def check_played(path: str) -> None:
    """Raise OutputError if a file that plays can surely not be written there."""
    check_named(path)
    target = os.path.realpath(path)
    if os.path.exists(target) and not os.path.isfile(target):
        raise OutputError(f"{path}: the output is a device, wanted a file for pictures that play")
    if suffix_of(path) == ".mp4":
        need_ffmpeg(path)


def padding(path: str, width: int, height: int) -> str | None:
    """Tell of the black that is added to a film whose sides its codec cannot have; None if there is none."""
    even = width + width % 2, height + height % 2
    if suffix_of(path) != ".mp4" or even == (width, height):
        return None
    became = f"{width}x{height} becomes {even[0]}x{even[1]}"
    return f"{path}: the sides of a film are even, so black is added at the right or below: {became}"


class Reel:
    """Keeps the frames of files that play, in a directory that is there.

    look  called often while a file is written: what it raises ends the writing
    """

    def __init__(self, folder: str, look: Callable[[], object] = lambda: None) -> None:
        self.folder, self._look = folder, look

    def add(self, number: int, picture: NDArray[np.uint8]) -> None:
        """Take a frame, uint8 (height, width, 3). Raises OutputError if there is no room for it."""
        from PIL import Image

        image = Image.fromarray(picture)
        write_whole(self.file(number), lambda file: image.save(file, "PNG", compress_level=1))

    def take(self, number: int, picture: str) -> None:
        """Take a frame from a .png that is there. Raises OutputError."""
        try:
            with open(picture, "rb") as there:
                write_whole(self.file(number), lambda file: shutil.copyfileobj(there, file))
        except OSError as error:
            raise OutputError(f"{picture}: the picture cannot be read ({error.strerror})") from None

    def has(self, number: int) -> bool:
        """Test that a frame waits here."""
        return os.path.isfile(self.file(number))

    def file(self, number: int) -> str:
        """Return the path of a frame that waits."""
        return os.path.join(self.folder, f"{number:09d}.png")

    def play(self, path: str, numbers: Sequence[int], fps: float) -> None:
        """Write a file of frames that all wait here; their numbers follow each other. Raises OutputError."""
        suffix = suffix_of(path)
        if suffix == ".mp4":
            self._write_film(path, numbers, fps)
        elif suffix == ".gif":
            shown = max(2 * GIF_TICK, round(1000.0 / fps / GIF_TICK) * GIF_TICK)
            images = (image.quantize(256) for image in self._images(numbers))
            write_whole(path, lambda file: _save_all(file, "GIF", images, shown, {}))
        else:
            shown = max(1, round(1000.0 / fps))
            write_whole(path, lambda file: _save_all(file, "WEBP", self._images(numbers), shown, {"lossless": True}))

    def _images(self, numbers: Sequence[int]) -> Iterator[Image]:
        from PIL import Image

        for number in numbers:
            self._look()
            with Image.open(self.file(number)) as image:
                yield image.convert("RGB")

    def _write_film(self, path: str, numbers: Sequence[int], fps: float) -> None:
        """ffmpeg reads the frames as they wait; sides are made even by black, as its codec wants.

        It ends with 0 although the disk was full, so what it says counts as well, and the film is looked through.
        """
        check_played(path)
        check_kept(path)
        target = os.path.realpath(path)
        limit = FFMPEG_SECONDS + len(numbers)
        command = [*QUIETLY, "-y", "-framerate", f"{fps:.10g}", "-start_number", str(numbers[0]), "-i", "%09d.png"]
        command += ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p"]
        command += ["-frames:v", str(len(numbers))]
        try:
            with replacing(target, ".mp4") as (part, file):
                self._run([*command, part], path, limit)
                os.fsync(file.fileno())
                self._look_through(part, path, len(numbers), limit)
        except OSError as error:
            raise OutputError(f"{path}: the film cannot be written by ffmpeg ({error.strerror or error})") from None

    def _run(self, command: list[str], path: str, limit: float) -> bytes:
        """Run ffmpeg with these arguments; what it wrote to standard output. Raises OutputError in its words if it failed."""
        pipe, none = subprocess.PIPE, subprocess.DEVNULL
        ending = time.monotonic() + limit
        with subprocess.Popen(
            [need_ffmpeg(path), *command], cwd=self.folder, stdin=none, stdout=pipe, stderr=pipe
        ) as process:
            try:
                while True:
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        told, said = process.communicate(timeout=LOOK_SECONDS)
                        break
                    self._look()
                    if time.monotonic() > ending:
                        raise OutputError(f"{path}: ffmpeg has not ended within {limit:.0f} seconds")
            except BaseException:
                process.kill()
                raise
        words = " ".join(said.decode(errors="replace").split())
        if process.returncode != 0 or words:
            raise OutputError(f"{path}: ffmpeg has failed ({words[-300:] or f'exit code {process.returncode}'})")
        return told

    def _look_through(self, part: str, path: str, frames: int, limit: float) -> None:
        """Raise OutputError unless a film has so many frames and each can be decoded."""
        command = [*QUIETLY, "-xerror", "-i", part, "-map", "0:v", "-c", "copy", "-f", "framecrc", "pipe:1"]
        told = self._run([*command, "-map", "0:v", "-f", "null", "-"], path, limit)
        found = sum(not line.startswith(b"#") for line in told.splitlines())
        if found != frames:
            raise OutputError(f"{path}: the film that ffmpeg wrote has {found} frames, wanted {frames}")


def _save_all(file: BinaryIO, kind: str, images: Iterator[Image], shown: int, options: dict[str, object]) -> None:
    first = next(images)
    first.save(file, kind, save_all=True, append_images=images, duration=shown, loop=0, **options)


@contextlib.contextmanager
def waiting() -> Iterator[Reel]:
    """Make a reel in a temporary directory, which is gone at the end. Raises OutputError if none can be made."""
    try:
        folder = PartFolder()
    except OSError as error:
        raise OutputError(f"no temporary directory for frames can be made ({error.strerror}): set TMPDIR") from None
    try:
        yield Reel(folder.path)
    finally:
        folder.remove()
