"""Packs and reads what travels on a link: a 20-byte header, then 25-byte packets, surface descriptions, or an order.

    header   kind u8, zero u8, epoch u16, sequence u32, credit u32, count u32, checksum u32      (little-endian)

epoch     number of resets of the machine so far; another epoch's message is stale
sequence  of this direction of this link, from 0, without gaps
credit    how many PACKETS and SURFACES messages the sender of this header has processed so far; the other
          side may have at most WINDOW unprocessed ones under way
count     packets or surfaces in the message, else 0
checksum  the low half of the XXH3 of what follows the header, seeded with that of the 16 bytes before the checksum:
          sequence numbers find what is lost, doubled or out of order, this finds what was changed or cut

The header is link protocol, not packet (law 2). Orders are msgpack maps with string keys; nothing that comes
in is trusted: lengths, types and finiteness are checked here before anything is used (law 11).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from xxhash import xxh3_64_intdigest

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.surfaces import OWN_HALF, STORED_AS, STRIDE, SURFACE_KINDS, AddedKind, Batch, Kind
from raygrid.node.protocol.codec import pack_map, read_map
from raygrid.node.protocol.packets import SIZE

VERSION = 2
# bytes; ZMQ_MAXMSGSIZE of every socket; a frame of the most materials and lights takes half of it
MAX_MESSAGE = 1 << 25
WINDOW = 32  # PACKETS and SURFACES messages under way on one direction of a link
HEAD = 20  # bytes of a header, kept free at the head of every output
HEADER = struct.Struct("<BBHIIII")
# where fields begin; the checksum sums what is before it
EPOCH_AT, SEQUENCE_AT, CREDIT_AT, COUNT_AT, SUMMED = 2, 4, 8, 12, 16
CHECKSUM_FIELD = struct.Struct("<I")
SURFACE_HEADER = struct.Struct("<BBHII")  # corner, kind, zero, surfaces, points of polygons
assert HEADER.size == HEAD == SUMMED + CHECKSUM_FIELD.size


class MessageKind(IntEnum):
    """First byte of a message."""

    HELLO = 1  # order: who I am
    ACK = 2  # I have seen your HELLO
    PACKETS = 3
    SURFACES = 4
    DOWN = 5  # a wave on its way from the root: a command
    UP = 6  # its answer
    CREDIT = 7  # nothing but the header
    BYE = 8  # nothing more will come
    BYE_ACK = 9
    STAMPED = 10  # packets with their ticks of machine time (`node.protocol.timestamps`)
    LOOKAHEAD = 11  # a look-ahead request of a node in machine time, or its answer
    REDUCE = 12  # a wave of a trace on its way from the root (`node.runtime.reduction`)
    REDUCED = 13  # its reply


_KINDS = {int(kind): kind for kind in MessageKind}
IS_DATA = frozenset((MessageKind.PACKETS, MessageKind.SURFACES, MessageKind.STAMPED, MessageKind.LOOKAHEAD))


class Header(NamedTuple):
    """The decoded head of a message."""

    kind: MessageKind
    epoch: int
    sequence: int
    credit: int
    items: int


def pack_message(kind: int, epoch: int, sequence: int, credit: int, count: int, payload: bytes) -> bytes:
    """A whole message."""
    head = HEADER.pack(kind, 0, epoch, sequence, credit, count, 0)[:SUMMED]
    checksum = xxh3_64_intdigest(payload, xxh3_64_intdigest(head)) & 0xFFFFFFFF
    return head + CHECKSUM_FIELD.pack(checksum) + payload


def seal(message: bytearray | memoryview) -> None:
    """Write the checksum into a message of HEAD bytes or more."""
    CHECKSUM_FIELD.pack_into(message, SUMMED, _checksum(message))


def is_whole(message: bytes) -> bool:
    """Whether a message of HEAD bytes or more has the checksum that it says."""
    return bool(CHECKSUM_FIELD.unpack_from(message, SUMMED)[0] == _checksum(message))


def _checksum(message: bytes | bytearray | memoryview) -> int:
    view = memoryview(message)
    return xxh3_64_intdigest(view[HEAD:], xxh3_64_intdigest(view[:SUMMED])) & 0xFFFFFFFF


def read_header(message: bytes) -> Header:
    """Decode and check a header, but for its checksum (`is_whole`). Raises ProtocolError."""
    if not HEAD <= len(message) <= MAX_MESSAGE:
        raise ProtocolError(f"a message came with {len(message)} bytes, wanted {HEAD} to {MAX_MESSAGE}")
    kind, zero, epoch, sequence, credit, count, _ = HEADER.unpack_from(message)
    known = _KINDS.get(kind)
    if known is None or zero != 0:
        raise ProtocolError(f"a message came with header {message[:HEAD].hex()}, wanted a known kind and a zero byte")
    return Header(known, epoch, sequence, credit, count)


def check_packets(message: bytes, count: int) -> None:
    """Raise ProtocolError unless the message is exactly as long as `count` packets."""
    if len(message) != HEAD + count * SIZE or count == 0:
        raise ProtocolError(
            f"{count} packets came in {len(message) - HEAD} bytes, wanted {count * SIZE} and at least one"
        )


def pack_order(order: Mapping[str, object]) -> bytes:
    """An order (or answer) as bytes. Raises ProtocolError if it is too long for a message."""
    return _short_enough(pack_map(order), "an order")


def _short_enough(payload: bytes, what: str) -> bytes:
    if len(payload) > MAX_MESSAGE - HEAD:
        raise ProtocolError(f"{what} has {len(payload)} bytes, wanted at most {MAX_MESSAGE - HEAD}")
    return payload


def read_order(message: bytes) -> dict[str, Any]:
    """The order of a message. Raises ProtocolError unless it is one map, with string keys all the way down."""
    return read_map(memoryview(message)[HEAD:], "an order")


def pack_surfaces(corner: int, batch: Batch) -> bytes:
    """Surface descriptions in machine coordinates, that entered the array at this corner (0 to 7), or moved (8).

    Raises ProtocolError if they are too long for a message.
    """
    points = int(batch.starts[-1]) if batch.kind == Kind.POLYGON else 0
    parts = [
        SURFACE_HEADER.pack(corner, int(batch.kind), 0, len(batch), points),
        batch.ids.astype("<u4", copy=False).tobytes(),
        batch.materials.astype("<u2", copy=False).tobytes(),
    ]
    if batch.kind == Kind.POLYGON:
        parts.append(np.diff(batch.starts).astype("<u4").tobytes())
    parts.append(batch.data.astype(STORED_AS[batch.kind], copy=False).tobytes())
    return _short_enough(b"".join(parts), f"a message of {len(batch)} surfaces of kind {batch.kind.name}")


def _are_placed(data: np.ndarray) -> bool:
    """Whether programmed surfaces have quaternions of length 1, scales above 0 and boxes not below 0."""
    lengths = np.sum(data[:, :4] ** 2, axis=1)
    half = data[:, OWN_HALF : OWN_HALF + 3]
    return bool(np.all(np.abs(lengths - 1.0) < 1e-6) and np.all(data[:, 4] > 0.0) and np.all(half >= 0.0))


def read_surfaces(message: bytes, count: int) -> tuple[int, Batch]:
    """(corner, descriptions) of a SURFACES message; corner 8: moved. Raises ProtocolError for anything else."""
    if len(message) < HEAD + SURFACE_HEADER.size:
        raise ProtocolError(f"surfaces came in {len(message) - HEAD} bytes, wanted {SURFACE_HEADER.size} or more")
    corner, kind_number, zero, n, points = SURFACE_HEADER.unpack_from(message, HEAD)
    if corner > 8 or kind_number not in SURFACE_KINDS or zero != 0 or n != count or n == 0:
        raise ProtocolError(f"surfaces came with corner {corner}, kind {kind_number}, {n} of {count}")
    kind = SURFACE_KINDS[kind_number]
    polygon = kind == Kind.POLYGON
    dtype = np.dtype(STORED_AS[kind])
    rows = points if polygon else n
    expected = HEAD + SURFACE_HEADER.size + n * (6 + 4 * polygon) + rows * STRIDE[kind] * dtype.itemsize
    if len(message) != expected or (not polygon and points != 0):
        raise ProtocolError(f"{n} surfaces of kind {kind.name} came in {len(message)} bytes, wanted {expected}")
    at = HEAD + SURFACE_HEADER.size
    ids = np.frombuffer(message, "<u4", n, at)
    materials = np.frombuffer(message, "<u2", n, at + 4 * n)
    at += 6 * n
    starts = np.zeros(0, np.int64)
    if polygon:
        sizes = np.frombuffer(message, "<u4", n, at).astype(np.int64)
        starts = np.concatenate(([0], np.cumsum(sizes)))
        at += 4 * n
        if sizes.min() < 3 or starts[-1] != points:
            raise ProtocolError(f"{n} polygons came with {int(sizes.min())} or more points each, {points} in all")
    data = np.frombuffer(message, dtype, rows * STRIDE[kind], at).reshape(rows, STRIDE[kind])
    if not np.all(np.abs(data) < 1e6):  # false for not-a-number too; machine coordinates are below 2
        raise ProtocolError(f"{n} surfaces of kind {kind.name} came with numbers beyond the world box")
    if kind == AddedKind.PROGRAMMED and not _are_placed(data):
        raise ProtocolError(f"{n} programmed surfaces came, of which some are turned, scaled or bounded by nothing")
    return corner, Batch(kind, ids, materials, data, starts)
