"""Makes the texts that a PNG keeps beside its pixels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.PngImagePlugin import PngInfo


def png_texts(texts: Mapping[str, str]) -> PngInfo:
    """Return what Pillow's `pnginfo` wants, of keywords and their Latin-1 texts."""
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    for keyword, text in texts.items():
        info.add_text(keyword, text)
    return info
