"""Writes pixels as a picture of the format that a name chooses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from raygrid.host.image.outputs import FORMATS, check_side, suffix_of


def pixel_writer(
    path: str | Path, pixels: NDArray[np.uint8], texts: Mapping[str, str] | None = None
) -> Callable[[BinaryIO], object]:
    """Return what writes pixels, uint8 (height, width, 3), into a file.

    texts  kept beside them in a .png, keyword -> Latin-1 text
    Raises OutputError for a side that the format has no room for.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    check_side(path, pixels.shape[1], pixels.shape[0])
    kind, image = FORMATS[suffix_of(path)], Image.fromarray(pixels)
    options = dict(kind.options)
    if texts and kind.name == "PNG":
        info = PngInfo()
        for keyword, text in texts.items():
            info.add_text(keyword, text)
        options["pnginfo"] = info
    return lambda file: image.save(file, kind.name, **options)
