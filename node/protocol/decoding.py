"""Decodes one packet at a time, for messages, traces and tests."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raygrid.node.errors import PacketError
from raygrid.node.protocol.packets import (
    FAULTS,
    PIXEL,
    RETURN,
    SHADOW,
    SIZE,
    PacketKind,
    PacketLimits,
    fault,
    get_intensity,
    read_u16,
    read_u24,
    read_u32,
    read_u48,
    unpack_shadow_weight,
    unpack_weight,
)
from raygrid.node.protocol.packing import unit_vector


class Packet(NamedTuple):
    """A decoded packet; fields that its kind does not have are None."""

    kind: PacketKind
    depth: int
    number: int  # sample, or pixel of a pixel packet
    origin: tuple[int, int, int] | None = None
    direction: tuple[float, float, float] | None = None
    light: int | None = None
    values: tuple[float, float, float] | tuple[int, int, int] = (0.0, 0.0, 0.0)  # weight, intensity or sum
    home: tuple[int, int, int] | None = None
    samples: int | None = None


def check(data: bytes, limits: PacketLimits) -> None:
    """Raise PacketError unless `data` is one packet of a frame with these limits. Never pads, never cuts."""
    if len(data) != SIZE:
        raise PacketError(f"a packet came with {len(data)} bytes, wanted {SIZE}")
    bad = fault(np.frombuffer(bytearray(data), np.uint8), 0, limits)
    if bad:
        raise PacketError(f"packet {data.hex()}: {FAULTS[bad]}")


def decode(data: bytes) -> Packet:
    """The fields of one packet that has passed `check`. Raises PacketError for another length or kind."""
    if len(data) != SIZE or data[0] & 7 not in PacketKind.__members__.values():
        raise PacketError(f"{len(data)} bytes {data[:SIZE].hex()} are no packet")
    raw = np.frombuffer(bytearray(data), np.uint8)
    kind, depth, number = PacketKind(data[0] & 7), data[0] >> 3, int(read_u32(raw, 1))
    if kind == PIXEL:
        sums = (int(read_u48(raw, 5)), int(read_u48(raw, 11)), int(read_u48(raw, 17)))
        return Packet(kind, depth, number, values=sums, samples=int(read_u16(raw, 23)))
    if kind == RETURN:
        r, g, b = get_intensity(raw, 0)
        home = (int(read_u16(raw, 17)), int(read_u16(raw, 19)), int(read_u16(raw, 21)))
        return Packet(kind, depth, number, values=(float(r), float(g), float(b)), home=home)
    origin = (int(read_u24(raw, 5)), int(read_u24(raw, 8)), int(read_u24(raw, 11)))
    if kind == SHADOW:
        r, g, b = (float(unpack_shadow_weight(read_u24(raw, 16 + 3 * k))) for k in range(3))
        return Packet(kind, depth, number, origin, light=int(read_u16(raw, 14)), values=(r, g, b))
    x, y, z = unit_vector(read_u24(raw, 14), read_u24(raw, 17))
    r, g, b = unpack_weight(read_u32(raw, 20) | (int(raw[24]) << 32))
    return Packet(kind, depth, number, origin, (float(x), float(y), float(z)), values=(float(r), float(g), float(b)))


def describe(data: bytes) -> str:
    """One line for logs and error messages."""
    packet = decode(data)
    if packet.kind == PIXEL:
        return "pixel {}, sum {} {} {}, samples {}".format(packet.number, *packet.values, packet.samples)
    parts = [f"{packet.kind.name.lower()} sample {packet.number}, depth {packet.depth}"]
    if packet.origin is not None:
        parts.append("from {}".format(" ".join(map(str, packet.origin))))
    if packet.direction is not None:
        parts.append("towards {:.4f} {:.4f} {:.4f}".format(*packet.direction))
    if packet.light is not None:
        parts.append(f"light {packet.light}")
    if packet.home is not None:
        parts.append("home {},{},{}".format(*packet.home))
    parts.append("values {:g} {:g} {:g}".format(*packet.values))
    return ", ".join(parts)
