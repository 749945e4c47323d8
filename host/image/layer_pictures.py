"""Encodes the layers of a picture: as numbers, as channels of an EXR, and as pictures to look at."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from raygrid.host.image.layer_names import NUMBERS
from raygrid.host.image.npy import write_npy
from raygrid.host.image.outputs import SUMS, suffix_of, write_whole
from raygrid.host.image.pixel_writer import pixel_writer
from raygrid.host.image.radiance import write_pfm

Layer = NDArray[Any]
Bytes = NDArray[np.uint8]

FARTHEST_GREY = 0.15  # of the farthest surface in a picture of depths: the background alone is black
GOLDEN = 0.6180339887498949  # of a turn round the colours: numbers that follow each other differ most


def channels_of(layers: Mapping[str, Layer]) -> dict[str, Layer]:
    """Name the layers as the channels of an EXR that compositing programs know: Z, N.X N.Y N.Z, id, material.

    Depths and normals are float32, numbers uint32; no surface is 2^32 - 1.
    """
    channels: dict[str, Layer] = {}
    for layer, values in layers.items():
        if layer == "normal":
            channels |= {f"N.{axis}": np.ascontiguousarray(values[..., k]) for k, axis in enumerate("XYZ")}
        elif layer == "depth":
            channels["Z"] = values
        else:
            channels["id" if layer == "surface" else layer] = values.astype(np.uint32)
    return channels


def save_layer(path: str, layer: str, values: Layer) -> None:
    """Write a layer as the suffix says: numbers (.npy .pfm), else a picture to look at, as `layer_picture` makes it.

    Raises OutputError.
    """
    write_whole(path, _writer(path, layer, values))


def _writer(path: str, layer: str, values: Layer) -> Callable[[BinaryIO], object]:
    suffix = suffix_of(path)
    if suffix == SUMS:
        return functools.partial(write_npy, values)
    if suffix == ".pfm":
        return functools.partial(write_pfm, values)
    return pixel_writer(path, layer_picture(layer, values))


def layer_picture(layer: str, values: Layer) -> Bytes:
    """Show a layer as a picture to look at, uint8 (height, width, 3): black where there is no surface.

    Depths are grey, the nearest white; of normals x, y and z from -1 to 1 are red, green and blue from 0 to 255. The
    colour of a number of a surface or material depends on it alone, and of thousands some are alike.
    """
    if layer == "depth":
        return _greys(values)
    return _colours_of_numbers(values) if layer in NUMBERS else _colours_of_normals(values)


def _greys(depths: Layer) -> Bytes:
    there = np.isfinite(depths)
    near, far = (float(depths[there].min()), float(depths[there].max())) if there.any() else (0.0, 1.0)
    nearness = 1.0 - (np.where(there, depths, near) - near) / max(far - near, 1e-30)
    grey = np.where(there, FARTHEST_GREY + (1.0 - FARTHEST_GREY) * nearness, 0.0)
    return np.repeat(np.rint(grey * 255.0).astype(np.uint8)[..., None], 3, axis=2)


def _colours_of_normals(normals: Layer) -> Bytes:
    there = normals.any(axis=2, keepdims=True)
    return np.where(there, np.rint((normals.astype(np.float64) + 1.0) * 127.5), 0.0).astype(np.uint8)


def _colours_of_numbers(numbers: Layer) -> Bytes:
    """Hues by the golden section, in nine kinds of lightness and saturation."""
    seen, places = np.unique(numbers, return_inverse=True)
    hue = seen * GOLDEN % 1.0
    value, saturation = 1.0 - 0.22 * (seen % 3), 0.9 - 0.25 * (seen // 3 % 3)
    channels = [
        np.clip(np.abs((hue + shift) % 1.0 * 6.0 - 3.0) - 1.0, 0.0, 1.0) for shift in (0.0, 2.0 / 3.0, 1.0 / 3.0)
    ]
    colours = value[:, None] * (1.0 - saturation[:, None] * (1.0 - np.stack(channels, axis=1)))
    table = np.where((seen >= 0)[:, None], np.rint(colours * 255.0), 0.0).astype(np.uint8)
    return table[places.reshape(numbers.shape)]
