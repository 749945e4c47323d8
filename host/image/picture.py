"""Holds the exact sums of a frame's pixels, and encodes them as pictures."""

from __future__ import annotations

import builtins
import contextlib
import functools
import io
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raygrid.host.image.outputs import (
    FORMATS,
    RADIANCE,
    SUMS,
    check_format,
    check_picture_path,
    check_side,
    suffix_of,
    write_whole,
)
from raygrid.host.image.transfer import TRANSFERS, to_bytes
from raygrid.node.errors import OutputError
from raygrid.node.tracing import UNIT

if TYPE_CHECKING:
    from PIL.PngImagePlugin import PngInfo

MOST_AHEAD = 1 << 22  # pixels of a picture that is encoded in memory


@dataclass(frozen=True, repr=False)
class Picture:
    """A rendered frame.

    sums     int64 (height, width, 3): sum over a pixel's samples of round(linear radiance * 2^24), row 0 on top
    samples  samples a pixel
    stats    what the machine did (docs/stats.md), or an empty map
    """

    sums: NDArray[np.int64]
    samples: int
    stats: dict[str, Any]

    def linear(self) -> NDArray[np.float64]:
        """Return linear radiance, float64 (height, width, 3): sums / (2^24 samples)."""
        return self.sums / (UNIT * self.samples)

    def blank(self) -> str | None:
        """Explain a picture that shows nothing, so that nobody takes it for a fault; None if it shows something."""
        if self.stats["total"]["hits"] == 0:
            return "no ray of the camera meets a surface: the picture shows the background only"
        if not self.sums.any():
            return "the picture is all black: no light reaches what the camera sees; is it behind a wall, or outside a room?"
        return None

    def bytes(self, transfer: str = "srgb") -> NDArray[np.uint8]:
        """Convert to uint8 (height, width, 3), values above 1 cut off. transfer: "srgb" (IEC 61966-2-1) or "linear".

        Raises OutputError for another transfer.
        """
        if transfer not in TRANSFERS:
            raise OutputError(f"a transfer came as {transfer!r}, wanted one of: {' '.join(TRANSFERS)}")
        return to_bytes(self.sums, self.samples, transfer)

    def save(self, path: str | Path, transfer: str = "srgb", texts: Mapping[str, str] | None = None) -> None:
        """Write a .npy of the sums, linear radiance (.pfm .hdr .exr), or a picture (.png .jpg .webp .tif .bmp .ppm .tga .jp2).
        It appears whole or not at all; - is standard output, a PNG.

        texts  kept beside the picture in a .png, keyword -> Latin-1 text
        Raises OutputError.
        """
        check_picture_path(path)
        write_whole(path, self._writer(path, transfer, texts))

    def encoded(self, path: str | Path, transfer: str = "srgb") -> memoryview:
        """Encode the picture as `save` writes it under this name, whatever may be there. Raises OutputError."""
        check_format(path)
        file = io.BytesIO()
        self._writer(path, transfer, None)(file)
        return file.getbuffer()

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """The values of a display, as `bytes()` gives them, for np.asarray(picture): uint8 (height, width, 3) unless another
        dtype is asked for; they are not rescaled. Radiance is `linear()`. Raises ValueError for copy=False."""
        if copy is False:
            raise ValueError(
                "the display values of a picture came with copy=False, wanted a copy: they are made when asked for"
            )
        values = self.bytes()
        return values if dtype is None else values.astype(dtype, copy=False)

    def __repr__(self) -> str:
        height, width, _ = self.sums.shape
        of = f" of {self.stats['scene']}" if "scene" in self.stats else ""
        return f"<raygrid.Picture{of}, {width}x{height}, {self.samples} {'sample' if self.samples == 1 else 'samples'} a pixel>"

    def _repr_png_(self) -> builtins.bytes:
        """The PNG that `save` writes: a notebook shows the picture."""
        return builtins.bytes(self.encoded("picture.png"))

    def _writer(self, path: str | Path, transfer: str, texts: Mapping[str, str] | None) -> Callable[[BinaryIO], object]:
        """What writes the format that the name chooses."""
        suffix = suffix_of(path)
        if suffix == SUMS:
            return self._write_sums
        if suffix in RADIANCE:
            from raygrid.host.image.radiance import WRITERS

            return functools.partial(WRITERS[suffix], self.linear())
        from PIL import Image

        check_side(path, self.sums.shape[1], self.sums.shape[0])
        kind = FORMATS[suffix]
        image = Image.fromarray(self.bytes(transfer))
        options = kind.options | ({"pnginfo": _png_texts(texts)} if texts and kind.name == "PNG" else {})
        return lambda file: image.save(file, kind.name, **options)

    def _write_sums(self, file: BinaryIO) -> None:
        """What np.save writes, but in its own words an error of the disk would say nothing of it."""
        sums = np.ascontiguousarray(self.sums)
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(sums))
        file.write(sums.data)


class Encoder:
    """Encodes a picture for some files in a thread of its own, while the caller waits for something else; `save` then
    writes it. What is large, or goes wrong, is left to `Picture.save`, and so are its errors."""

    def __init__(self, picture: Picture, paths: Sequence[str], transfer: str) -> None:
        self._picture, self._transfer = picture, transfer
        self._encoded: dict[str, memoryview] = {}
        small = picture.sums.size <= 3 * MOST_AHEAD
        self._paths = [path for path in paths if small and suffix_of(path) in FORMATS]
        self._thread = threading.Thread(target=self._encode, name="encoding", daemon=True)
        if self._paths:
            self._thread.start()

    def _encode(self) -> None:
        with contextlib.suppress(Exception):
            for path in self._paths:
                self._encoded[path] = self._picture.encoded(path, self._transfer)

    def save(self, path: str) -> None:
        """Write one of the files. Raises OutputError."""
        if self._paths:
            self._thread.join()
        encoded = self._encoded.get(path)
        if encoded is None:
            self._picture.save(path, self._transfer)
        else:
            write_whole(path, lambda file: file.write(encoded))


def prepare(paths: Sequence[str | Path]) -> None:
    """Import what writing these files needs, while there is time for it."""
    if any(suffix_of(path) in FORMATS for path in paths):
        from PIL import Image

        Image.preinit()


def _png_texts(texts: Mapping[str, str]) -> PngInfo:
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    for keyword, text in texts.items():
        info.add_text(keyword, text)
    return info
