"""Whether the file of a frame is there, whole, and of just that frame: what `--resume` skips."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from raygrid.host.outputs import SUMS

KEYWORD = "raygrid"  # of the digest in a .png
PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
Recorded = Callable[[str, str], bool]


def is_whole(path: str, digest: str, width: int, height: int, recorded: Recorded) -> bool:
    """Whether the file at `path` is the picture of that digest and size, and can be read to its end.

    recorded  whether the journal says that this file was written with that digest and has not been changed since;
              for a .png the digest inside it is enough
    """
    if not os.path.isfile(path):
        return False
    if os.path.splitext(path)[1].lower() == SUMS:
        return recorded(path, digest) and _sums_are_whole(path, width, height)
    found = _digest_of_picture(path, width, height)
    return found is not None and (found == digest or recorded(path, digest))


def _sums_are_whole(path: str, width: int, height: int) -> bool:
    try:
        sums = np.load(path, mmap_mode="r", allow_pickle=False)  # fails if the file is too short
    except (OSError, ValueError, EOFError):
        return False
    return bool(sums.shape == (height, width, 3) and sums.dtype == np.int64)


def _digest_of_picture(path: str, width: int, height: int) -> str | None:
    """The digest inside a picture, "" if there is none; None if the picture cannot be read, or has another size."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            picture.verify()  # of a .png every chunk, which the decoder does not need
            png = picture.format == "PNG"
        with Image.open(path) as picture:
            size = picture.size
            picture.load()  # all of it
            text = picture.info.get(KEYWORD, "")
    except Exception:  # Pillow's decoders raise nearly anything on damaged data
        return None
    if size != (width, height) or (png and not _has_png_end(path)):
        return None
    return text if isinstance(text, str) else ""


def _has_png_end(path: str) -> bool:
    with open(path, "rb") as file:
        file.seek(-len(PNG_END), os.SEEK_END)
        return file.read() == PNG_END
