"""Finds the program that encodes films: ffmpeg of the computer, else that which the extra `mp4` ships. Light to import."""

from __future__ import annotations

import importlib.util
import shutil

from raygrid.node.errors import OutputError

SHIPS = "imageio_ffmpeg"


def find_ffmpeg() -> str | None:
    """Return how ffmpeg is called: the one on the PATH, else that of the extra `mp4`; None if there is neither."""
    found = shutil.which("ffmpeg")
    if found is None and importlib.util.find_spec(SHIPS) is not None:
        import imageio_ffmpeg

        try:
            found = str(imageio_ffmpeg.get_ffmpeg_exe())
        except RuntimeError:  # a package of it without the program, for another kind of computer
            return None
    return found


def need_ffmpeg(path: str) -> str:
    """Return how ffmpeg is called. Raises OutputError, in the name of the film at `path`, if there is none."""
    found = find_ffmpeg()
    if found is None:
        raise OutputError(
            f"{path}: there is no ffmpeg on this computer, wanted it for .mp4 (or the extra: pip install 'raygrid[mp4]'), "
            "or .gif or .webp instead"
        )
    return found
