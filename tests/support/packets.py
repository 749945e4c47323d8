"""Packets as bytes, for the tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from reference import packing

from raygrid.node.protocol import packets

Cell = tuple[int, int, int]


def _written(put: Callable[..., Any], *fields: Any) -> bytes:
    """What a `put_` function writes; bytes before and behind the packet must stay as they were."""
    buffer = np.full(packets.SIZE + 2, 0xA5, np.uint8)
    put(buffer, 1, *fields)
    assert buffer[0] == 0xA5
    assert buffer[-1] == 0xA5
    return buffer[1:-1].tobytes()


def ray_bytes(kind: int, depth: int, sample: int, origin: Cell, codes: tuple[int, int], weight: int) -> bytes:
    """A primary, reflected or refracted ray; direction as codes, weight as 40 bits."""
    return _written(packing.put_ray, kind, depth, sample, origin, codes, weight)


def shadow_bytes(depth: int, sample: int, origin: Cell, light: int, weights: tuple[float, float, float]) -> bytes:
    """A shadow ray."""
    return _written(packing.put_shadow, depth, sample, origin, light, weights)


def return_bytes(depth: int, sample: int, intensity: tuple[float, float, float], home: Cell) -> bytes:
    """A return packet."""
    narrow = (np.float32(intensity[0]), np.float32(intensity[1]), np.float32(intensity[2]))
    return _written(packets.put_return, depth, sample, narrow, home)


def pixel_bytes(pixel: int, sums: Cell, samples: int) -> bytes:
    """A pixel packet."""
    return _written(packets.put_pixel, pixel, sums, samples)


def rows(data: bytes) -> np.ndarray:
    """Bytes as the flat uint8 array that kernels read."""
    return np.frombuffer(bytearray(data), np.uint8)


def rewritten(data: bytes) -> bytes:
    """The packet again, from the fields read out of its bytes."""
    raw = rows(data)
    kind, depth, number = data[0] & 7, data[0] >> 3, int(packets.read_u32(raw, 1))
    if kind == packets.PIXEL:
        sums = (int(packets.read_u48(raw, 5)), int(packets.read_u48(raw, 11)), int(packets.read_u48(raw, 17)))
        return pixel_bytes(number, sums, int(packets.read_u16(raw, 23)))
    if kind == packets.RETURN:
        home = (int(packets.read_u16(raw, 17)), int(packets.read_u16(raw, 19)), int(packets.read_u16(raw, 21)))
        return return_bytes(depth, number, packets.get_intensity(raw, 0), home)
    origin = (int(packets.read_u24(raw, 5)), int(packets.read_u24(raw, 8)), int(packets.read_u24(raw, 11)))
    if kind == packets.SHADOW:
        weights = tuple(float(packets.unpack_shadow_weight(packets.read_u24(raw, 16 + 3 * k))) for k in range(3))
        return shadow_bytes(depth, number, origin, int(packets.read_u16(raw, 14)), weights)
    codes = (int(packets.read_u24(raw, 14)), int(packets.read_u24(raw, 17)))
    return ray_bytes(kind, depth, number, origin, codes, int.from_bytes(data[20:25], "little"))
