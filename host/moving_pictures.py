"""Files that play: GIF and WebP by Pillow, MP4 where ffmpeg is installed.

The frames of a file wait as PNGs in a temporary directory, so that a long shot does not fill the memory; the file itself
appears whole or not at all.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO

from raygrid.host.outputs import check_path, write_whole
from raygrid.node.errors import OutputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PLAYED = (".gif", ".webp", ".mp4")
GIF_TICK = 10  # milliseconds; a GIF counts in these, and players take fewer than two of them for ten
FFMPEG_SECONDS = 60.0  # for it to end, once it has all frames


def check_played(path: str) -> None:
    """Raise OutputError if a file that plays can surely not be written there."""
    check_path(path)
    if Path(path).suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise OutputError(f"{path}: there is no ffmpeg on this computer, wanted it for .mp4, or .gif or .webp instead")


class Reel:
    """The frames of one file. Use as a context manager, so that what waits is removed.

    path  the file; fps frames a second
    """

    def __init__(self, path: str, fps: float) -> None:
        self.path, self.fps = path, fps
        self._waiting = tempfile.TemporaryDirectory(prefix="frames-of-raygrid-")
        self._frames = 0

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Take a frame, uint8 (height, width, 3). Raises OutputError if there is no room for it."""
        from PIL import Image

        try:
            Image.fromarray(picture).save(self._frame(self._frames), compress_level=1)
        except OSError as error:
            raise OutputError(
                f"{self.path}: a frame cannot be kept in {self._waiting.name} ({error.strerror})"
            ) from None
        self._frames += 1

    def write(self) -> None:
        """Write the file of all frames. Raises OutputError."""
        suffix = Path(self.path).suffix.lower()
        if suffix == ".mp4":
            self._write_film()
        else:
            write_whole(self.path, self._write_gif if suffix == ".gif" else self._write_webp)

    def _frame(self, number: int) -> str:
        return os.path.join(self._waiting.name, f"{number:07d}.png")

    def _images(self) -> Iterator[Any]:
        from PIL import Image

        for number in range(self._frames):
            with Image.open(self._frame(number)) as image:
                yield image.convert("RGB")

    def _write_gif(self, file: BinaryIO) -> None:
        shown = max(2 * GIF_TICK, round(1000.0 / self.fps / GIF_TICK) * GIF_TICK)
        self._write(file, "GIF", (image.quantize(256) for image in self._images()), shown, {})

    def _write_webp(self, file: BinaryIO) -> None:
        self._write(file, "WEBP", self._images(), max(1, round(1000.0 / self.fps)), {"lossless": True})

    def _write(self, file: BinaryIO, kind: str, images: Iterator[Any], shown: int, options: dict[str, Any]) -> None:
        first = next(images)
        first.save(file, kind, save_all=True, append_images=images, duration=shown, loop=0, **options)

    def _write_film(self) -> None:
        """ffmpeg reads the frames as they wait; sides are made even by a row of black, as its codec wants."""
        target = os.path.realpath(self.path)
        part = os.path.join(os.path.dirname(target), f".raygrid-{secrets.token_hex(6)}.mp4")
        command = ["ffmpeg", "-nostdin", "-loglevel", "error", "-y", "-framerate", f"{self.fps:g}"]
        command += ["-i", os.path.join(self._waiting.name, "%07d.png"), "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"]
        command += ["-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", part]
        try:
            limit = FFMPEG_SECONDS + self._frames
            done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=limit, check=False)
            if done.returncode != 0:
                said = " ".join(done.stderr.decode(errors="replace").split()) or f"exit code {done.returncode}"
                raise OutputError(f"{self.path}: ffmpeg has failed ({said[-300:]})")
            os.replace(part, target)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise OutputError(f"{self.path}: the film cannot be written by ffmpeg ({error})") from None
        finally:
            with contextlib.suppress(OSError):
                os.unlink(part)

    def __enter__(self) -> Reel:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waiting.cleanup()
