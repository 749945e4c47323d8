"""Messages as bytes, and surfaces of every kind to put in them, for the tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from raygrid.node.geometry.surfaces import Batch, Kind
from raygrid.node.protocol.messages import HEAD, HEADER, MessageKind, pack_surfaces, seal
from support.surfaces import batch, random_rows


def message(
    kind: int, payload: bytes = b"", count: int = 0, sequence: int = 0, credit: int = 0, epoch: int = 0, zero: int = 0
) -> bytes:
    """A whole message."""
    return sealed(HEADER.pack(kind, zero, epoch, sequence, credit, count, 0) + payload)


def sealed(raw: bytes) -> bytes:
    """The message with the checksum that it should have, if it has a header."""
    data = bytearray(raw)
    if len(data) >= HEAD:
        seal(data)
    return bytes(data)


def surfaces_message(surfaces: Batch, corner: int = 0) -> bytes:
    """A SURFACES message."""
    return message(MessageKind.SURFACES, pack_surfaces(corner, surfaces), len(surfaces))


def random_batch(kind: Kind, n: int, seed: int = 0) -> Batch:
    """Surfaces of one kind with ids and materials of their own."""
    rng = np.random.default_rng([seed, kind])
    return batch(kind, random_rows(kind, rng, n), first_id=1000 * kind, materials=rng.integers(0, 65536, n).tolist())


def same_batch(one: Batch, other: Batch) -> bool:
    """Whether two batches hold the same bits."""
    return (
        one.kind == other.kind
        and one.data.dtype == other.data.dtype
        and all(
            np.array_equal(getattr(one, name), getattr(other, name)) for name in ("ids", "materials", "data", "starts")
        )
    )


# what msgpack can carry, and so what may stand in an order
scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**63), 2**64 - 1),
    st.floats(allow_nan=False),
    st.text(max_size=5),
    st.binary(max_size=20),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=4), inner, max_size=4)),
    max_leaves=12,
)
orders = st.dictionaries(st.text(max_size=6), values, max_size=6)
