"""Bakes a texture's colours into the materials of single triangles, since the nodes know no textures.

A triangle gets the colour of the texel under its middle, its primaries rounded to 5 bits: that is one material for each
colour that occurs, at most 32,768 a texture, and no eye sees the steps on a mesh fine enough for its texture to show.
Textures and vertex colours are sRGB; materials are linear.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from enum import Enum
from functools import cache

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.builder import Table
from raygrid.host.scene.file_access import take_texels
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, rounded

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

BITS = 5  # of each primary
MOST_TEXELS = 1 << 26  # of one texture, 8192 x 8192
# What Pillow reads by itself. Others it hands to programs of the computer (EPS to Ghostscript), where a scene has no place.
FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "TGA", "BMP", "GIF", "PPM", "DDS", "SGI", "PCX", "PSD", "JPEG2000")


class Wrap(Enum):
    """Says what lies outside a texture; the values are glTF's."""

    REPEAT = 10497
    CLAMP = 33071
    MIRROR = 33648


@dataclass(frozen=True)
class Texture:
    """A picture with what lies outside it: texels uint8 (height, width, 3), sRGB, the top row first."""

    texels: Bytes
    wrap_u: Wrap = Wrap.REPEAT
    wrap_v: Wrap = Wrap.REPEAT

    def under(self, corners: F64) -> Bytes:
        """The texels under the middles of triangles, (n, 3).

        corners: (n, 3, 2), (0, 0) being the upper left corner of the picture and (1, 1) the lower right.
        """
        # Coordinates that are no numbers (files have them) take the first texel.
        uv = np.clip(np.nan_to_num(corners), -1e9, 1e9).mean(axis=1)
        height, width = self.texels.shape[:2]
        column = _texel(uv[:, 0], width, self.wrap_u)
        row = _texel(uv[:, 1], height, self.wrap_v)
        return self.texels[row, column]


def read_picture(data: bytes, where: str) -> Bytes:
    """Decode a picture of one of FORMATS: uint8 (h, w, 3). Raises SceneError, `where` names the picture.

    How large it is is looked at before it is decoded: a few kilobytes of PNG can be gigabytes of texels.
    """
    from PIL import Image  # only files with textures pay for it

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # MOST_TEXELS is less
            picture = Image.open(io.BytesIO(data), formats=FORMATS)
        with picture:
            take_texels(picture.width * picture.height, MOST_TEXELS, where)
            return np.asarray(picture.convert("RGB"))
    except SceneError:
        raise
    except Image.DecompressionBombError as error:  # Pillow's own limit, far above
        raise SceneError(
            f"{where}: the texture is too large ({error}), wanted at most {MOST_TEXELS:,} texels"
        ) from None
    except Exception as error:  # Pillow's decoders raise nearly anything on damaged data
        raise SceneError(f"{where}: the texture cannot be read ({_told(error)})") from None


def _told(error: Exception) -> str:
    from PIL import UnidentifiedImageError

    if isinstance(error, UnidentifiedImageError):
        return f"it is of no format known, wanted one of: {' '.join(FORMATS)}"
    return str(error)


def bake(row: Table, colours: Bytes, tints: tuple[str, ...] = ("diffuse",)) -> tuple[Table, Ints]:
    """Materials for triangles of different colours.

    row      the material to be tinted, MATERIAL (1,)
    colours  sRGB, uint8 (n, 3)
    tints    the fields that the colour multiplies

    Returns the materials, MATERIAL (m,), and the one that each colour got, (n,).
    """
    shift = 8 - BITS
    packed = colours.astype(np.int64) >> shift
    keys, index = np.unique((packed[:, 0] << 2 * BITS) | (packed[:, 1] << BITS) | packed[:, 2], return_inverse=True)
    levels = np.stack([keys >> 2 * BITS, keys >> BITS, keys], axis=1) & (2**BITS - 1)
    rows = np.repeat(row, len(keys))
    for field in tints:
        rows[field] *= linear(levels / (2**BITS - 1))
    return rows, index.astype(np.int64)


def linear(srgb: F64) -> F64:
    """sRGB from 0 to 1 made linear."""
    values, place = np.unique(srgb, return_inverse=True)
    return np.array([_linear(value) for value in values.tolist()])[place].reshape(np.shape(srgb))


@cache
def _linear(srgb: float) -> float:
    return srgb / 12.92 if srgb <= 0.04045 else rounded.power((srgb + 0.055) / 1.055, 2.4)


def as_bytes(colours: F64, is_linear: bool = False) -> Bytes:
    """Colours from 0 to 1, sRGB or linear, as sRGB bytes."""
    clipped = np.clip(colours, 0.0, 1.0)
    if is_linear:
        least = [_linear((byte - 0.5) / 255.0) for byte in range(1, 256)]  # of each byte
        return np.searchsorted(least, clipped, "right").astype(np.uint8)
    return np.round(255.0 * clipped).astype(np.uint8)


def _texel(coordinate: F64, size: int, wrap: Wrap) -> Ints:
    texel = np.floor(coordinate * size).astype(np.int64)
    if wrap is Wrap.CLAMP:
        return np.asarray(np.clip(texel, 0, size - 1))
    if wrap is Wrap.REPEAT:
        return np.asarray(texel % size)
    texel %= 2 * size
    return np.asarray(np.minimum(texel, 2 * size - 1 - texel))
