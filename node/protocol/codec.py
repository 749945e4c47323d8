"""Packs and reads maps that travel as msgpack: orders on links, messages on control channels and of clients. What comes in
is not trusted (law 11).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import msgpack

from raygrid.node.errors import ProtocolError

MOST_MAP_ITEMS = 1 << 16  # entries of any list or map
DEEPEST = 8  # lists and maps in each other
LONGEST_REASON = 200  # characters of what msgpack says


class MapLimits(NamedTuple):
    """What a map may be.

    most_items   entries of any list or map
    deepest      lists and maps in each other
    most_bytes   length of a string of bytes; -1: as long as the map
    """

    most_items: int = MOST_MAP_ITEMS
    deepest: int = DEEPEST
    most_bytes: int = -1


LIMITS = MapLimits()


def pack_map(value: Mapping[str, object]) -> bytes:
    """A map as bytes."""
    packed: bytes = msgpack.packb(value, use_bin_type=True)
    return packed


def read_map(data: bytes | bytearray | memoryview, what: str, limits: MapLimits = LIMITS) -> dict[str, Any]:
    """The map that these bytes are. Raises ProtocolError unless it is one, with string keys all the way down.

    what    how to call it in an error: "an order"
    limits  what is beyond them is refused as well
    """
    try:
        value = msgpack.unpackb(
            data,
            raw=False,
            strict_map_key=True,
            max_array_len=limits.most_items,
            max_map_len=limits.most_items,
            max_bin_len=limits.most_bytes,
            max_ext_len=0,
        )
    except (ValueError, msgpack.UnpackException, RecursionError) as error:
        raise ProtocolError(f"{what} of {len(data)} bytes cannot be read: {_reason(error)}") from None
    if not isinstance(value, dict):
        raise ProtocolError(f"{what} came as {type(value).__name__}, wanted a map")
    _check_tree(value, limits.deepest, limits, what)
    return value


def _check_tree(value: dict[str, object] | list[object], deeper: int, limits: MapLimits, what: str) -> None:
    """Raise ProtocolError for keys that are no strings, and for lists and maps nested too deep to be handed on."""
    if deeper == 0:
        raise ProtocolError(f"{what} came with lists and maps deeper than {limits.deepest}")
    if isinstance(value, dict) and not all(type(key) is str for key in value):
        raise ProtocolError(f"{what} came with keys that are bytes, wanted string keys")
    for inner in value.values() if isinstance(value, dict) else value:
        if isinstance(inner, dict | list):
            _check_tree(inner, deeper - 1, limits, what)


def _reason(error: BaseException) -> str:
    """What went wrong, in one line; some errors of msgpack have a name only."""
    return (str(error) or type(error).__name__).splitlines()[0][:LONGEST_REASON]
