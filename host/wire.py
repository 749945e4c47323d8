"""Messages between a client and an array that stays: maps in msgpack, each behind its length. No socket in here.

    +--------------------+-------------------+
    | length, u32 little | one map, msgpack  |
    +--------------------+-------------------+

What comes is checked before it is used: the length before it is waited for, the number of items and the depth of
nesting, and that there are only strings, numbers, booleans, nothing, lists and maps with string keys.
"""

from __future__ import annotations

import struct
from typing import Any

import msgpack

from raygrid.node.errors import ProtocolError

Message = dict[str, Any]

VERSION = 1
LENGTH = struct.Struct("<I")
LONGEST = 1 << 23  # bytes of a message
LONGEST_GREETING = 1 << 10  # of the first message of a client, before it is known
MOST_ITEMS = 1 << 17  # of a list or map
DEEPEST = 6  # lists and maps within each other
PLAIN = (str, int, float, bool, type(None))


def pack(message: Message) -> bytes:
    """A message as bytes. Raises ProtocolError if it is too long."""
    body: bytes = msgpack.packb(message, use_bin_type=True)
    if len(body) > LONGEST:
        raise ProtocolError(f"a message of {len(body)} bytes was to be sent, wanted at most {LONGEST}")
    return LENGTH.pack(len(body)) + body


def unpack(body: bytes | bytearray) -> Message:
    """The map in the body of a message. Raises ProtocolError for anything else."""
    try:
        message = msgpack.unpackb(
            body,
            raw=False,
            strict_map_key=True,
            max_array_len=MOST_ITEMS,
            max_map_len=MOST_ITEMS,
            max_bin_len=0,
            max_ext_len=0,
        )
    except (ValueError, msgpack.UnpackException, RecursionError) as error:
        raise ProtocolError(f"a message of {len(body)} bytes cannot be read: {_first_line(error)}") from None
    if not isinstance(message, dict):
        raise ProtocolError(f"a message came as {type(message).__name__}, wanted a map")
    _check(message, DEEPEST)
    return message


def _check(value: Message | list[Any], deeper: int) -> None:
    if deeper == 0:
        raise ProtocolError(f"a message came with lists and maps deeper than {DEEPEST}")
    if isinstance(value, dict) and not all(type(key) is str for key in value):
        raise ProtocolError("a message came with keys that are no strings")
    for inner in value.values() if isinstance(value, dict) else value:
        if isinstance(inner, dict | list):
            _check(inner, deeper - 1)
        elif not isinstance(inner, PLAIN):
            raise ProtocolError(f"a message came with {type(inner).__name__}, wanted plain text and numbers")


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:200]


class Splitter:
    """Cuts a stream of bytes into messages.

    longest   bytes of the longest message that is taken; may be changed between messages
    """

    def __init__(self, longest: int = LONGEST) -> None:
        self.longest = longest
        self._held = bytearray()

    @property
    def held(self) -> int:
        """Bytes of a message that has not come whole."""
        return len(self._held)

    def feed(self, piece: bytes) -> None:
        """Take in what has come."""
        self._held += piece

    def next(self) -> Message | None:
        """The next whole message, None if there is none yet. Raises ProtocolError."""
        if len(self._held) < LENGTH.size:
            return None
        (length,) = LENGTH.unpack_from(self._held)
        if length > self.longest:
            raise ProtocolError(f"a message of {length} bytes came, wanted at most {self.longest}")
        end = LENGTH.size + length
        if len(self._held) < end:
            return None
        body = bytes(self._held[LENGTH.size : end])
        del self._held[:end]
        return unpack(body)
