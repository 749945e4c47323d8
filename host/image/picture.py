"""Holds the exact sums of a frame's pixels, and encodes them as pictures."""

from __future__ import annotations

import builtins
import contextlib
import functools
import io
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raygrid.host.image.layer_names import check_outputs_of_layers, layer_files
from raygrid.host.image.npy import write_npy
from raygrid.host.image.outputs import (
    FORMATS,
    RADIANCE,
    SUMS,
    check_format,
    check_path,
    check_picture_path,
    suffix_of,
    write_whole,
)
from raygrid.host.image.pixel_writer import pixel_writer
from raygrid.host.image.transfer import TRANSFERS, to_bytes
from raygrid.node.errors import OutputError
from raygrid.node.tracing import UNIT

MOST_AHEAD = 1 << 22  # pixels of a picture that is encoded in memory


@dataclass(frozen=True, repr=False)
class Picture:
    """A rendered frame.

    sums     int64 (height, width, 3): sum over a pixel's samples of round(linear radiance * 2^24), row 0 on top
    samples  samples a pixel
    stats    what the machine did (docs/stats.md), or an empty map
    layers   those that were asked for, by name, of the first surface that the ray through a pixel's middle meets:
             depth     float32 (height, width), distance from the eye along the ray, in units of the scene; inf for none
             normal    float32 (height, width, 3), the unit normal that is shaded with, towards the eye; 0 for none
             surface   int32 (height, width), its number in the scene, -1 for none
             material  int32 (height, width), the number of its material, -1 for none
    """

    sums: NDArray[np.int64]
    samples: int
    stats: dict[str, Any]
    layers: dict[str, NDArray[Any]] = field(default_factory=dict)

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
        It appears whole or not at all; - is standard output, a PNG. An .exr has the picture's layers, too.

        texts  kept beside the picture in a .png, keyword -> Latin-1 text
        Raises OutputError.
        """
        check_picture_path(path)
        write_whole(path, self._writer(path, transfer, texts))

    def save_layers(self, path: str | Path) -> list[str]:
        """Write the layers beside a picture of this name, as `raygrid render --layers` does (docs/layers.md).

        Returns the names of the files, NAME.LAYER.SUFFIX; none for an .exr, which `save` writes with its layers.
        Raises OutputError.
        """
        from raygrid.host.image.layer_pictures import save_layer

        check_outputs_of_layers([os.fspath(path)], [], tuple(self.layers))
        check_picture_path(path)
        files = layer_files([os.fspath(path)], tuple(self.layers))
        for file, _ in files:
            check_path(file)
        for file, layer in files:
            save_layer(file, layer, self.layers[layer])
        return [file for file, _ in files]

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
        samples = f"{self.samples} {'sample' if self.samples == 1 else 'samples'} a pixel"
        layers = f", layers {' '.join(self.layers)}" if self.layers else ""
        return f"<raygrid.Picture{of}, {width}x{height}, {samples}{layers}>"

    def _repr_png_(self) -> builtins.bytes:
        """The PNG that `save` writes: a notebook shows the picture."""
        return builtins.bytes(self.encoded("picture.png"))

    def _writer(self, path: str | Path, transfer: str, texts: Mapping[str, str] | None) -> Callable[[BinaryIO], object]:
        """What writes the format that the name chooses."""
        suffix = suffix_of(path)
        if suffix == SUMS:
            return functools.partial(write_npy, self.sums)
        if suffix in RADIANCE:
            from raygrid.host.image.radiance import WRITERS, write_exr

            if suffix == ".exr" and self.layers:
                from raygrid.host.image.layer_pictures import channels_of

                return functools.partial(write_exr, self.linear(), channels=channels_of(self.layers))
            return functools.partial(WRITERS[suffix], self.linear())
        return pixel_writer(path, self.bytes(transfer), texts)


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
