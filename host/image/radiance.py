"""Writes linear radiance as floating-point pictures: PFM, Radiance HDR and, with the extra `exr`, OpenEXR.

PFM and EXR hold binary32 numbers, so that radiance above 1 and below 1/255 is kept; HDR holds three mantissas of 8 bits and
one exponent a pixel. How the bytes of displays are made (`--transfer`) does not matter to them.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

Radiance = NDArray[np.floating]

SCANLINES = range(8, 32_768)  # widths of HDR files whose rows are packed
LONGEST_RUN = 127


def write_pfm(radiance: Radiance, file: BinaryIO) -> None:
    """Write a PFM, of colours (height, width, 3) or grey (height, width): little-endian binary32, the lowest row first."""
    height, width = radiance.shape[:2]
    file.write(f"{'PF' if radiance.ndim == 3 else 'Pf'}\n{width} {height}\n-1.0\n".encode())
    file.write(np.ascontiguousarray(radiance[::-1], "<f4").tobytes())


def write_hdr(radiance: Radiance, file: BinaryIO) -> None:
    """Write a Radiance picture, RGBE with packed rows where the format has them (G. Ward, "Real Pixels", Graphics Gems II)."""
    height, width = radiance.shape[:2]
    file.write(f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode())
    for row in rgbe(radiance):
        if width in SCANLINES:
            file.write(bytes((2, 2, width >> 8, width & 255)))
            for channel in row.T:
                file.write(packed(channel))
        else:
            file.write(row.tobytes())


def rgbe(radiance: Radiance) -> NDArray[np.uint8]:
    """Three mantissas and their common exponent, uint8 (height, width, 4); too faint: all 0."""
    brightest = radiance.max(axis=2)
    _, exponent = np.frexp(brightest)
    exponent = np.where(brightest >= 1e-32, exponent, -128)
    scaled = np.ldexp(radiance, (8 - exponent)[..., None])
    table = np.concatenate((np.floor(scaled), (exponent + 128)[..., None]), axis=2)
    return np.where((exponent > -128)[..., None], np.minimum(table, 255.0), 0.0).astype(np.uint8)


def packed(values: NDArray[np.uint8]) -> bytes:
    """A channel of a row: runs of four and more as (128 + length, value), all else as (length, values)."""
    made, begin = bytearray(), 0
    ends = np.flatnonzero(np.concatenate((np.diff(values) != 0, [True]))) + 1
    lengths = np.diff(np.concatenate(([0], ends)))
    data = values.tobytes()
    for end, length in zip(ends[lengths >= 4].tolist(), lengths[lengths >= 4].tolist(), strict=True):
        _literal(made, data[begin : end - length])
        for first in range(0, length, LONGEST_RUN):
            made += bytes((128 + min(LONGEST_RUN, length - first), data[end - 1]))
        begin = end
    _literal(made, data[begin:])
    return bytes(made)


def _literal(made: bytearray, data: bytes) -> None:
    for first in range(0, len(data), 128):
        part = data[first : first + 128]
        made.append(len(part))
        made += part


def write_exr(radiance: Radiance, file: BinaryIO, channels: Mapping[str, NDArray[Any]] | None = None) -> None:
    """Write an OpenEXR picture of binary32 channels R, G and B, ZIP packed without loss.

    channels  others beside them by name, each (height, width), float32 or uint32
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    of_all = {"RGB": np.ascontiguousarray(radiance, np.float32), **(channels or {})}
    # The library writes files by name only: this one is in memory, and goes with the process, however that ends.
    with os.fdopen(os.memfd_create("picture", os.MFD_CLOEXEC), "w+b") as memory:
        with OpenEXR.File(header, of_all) as made:
            made.write(f"/proc/self/fd/{memory.fileno()}")
        memory.seek(0)
        shutil.copyfileobj(memory, file)


WRITERS: dict[str, Callable[[Radiance, BinaryIO], None]] = {".pfm": write_pfm, ".hdr": write_hdr, ".exr": write_exr}
