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

from raygrid.node.errors import ProtocolError
from raygrid.node.maps import Limits, pack_map, read_map

Message = dict[str, Any]

VERSION = 1
LENGTH = struct.Struct("<I")
LONGEST = 1 << 23  # bytes of a message
LONGEST_GREETING = 1 << 10  # of the first message of a client, before it is known
MOST_ITEMS = 1 << 17  # of a list or map
DEEPEST = 6  # lists and maps within each other
LIMITS = Limits(MOST_ITEMS, DEEPEST, most_bytes=0)
PLAIN = (str, int, float, bool, type(None))


def pack(message: Message) -> bytes:
    """A message as bytes. Raises ProtocolError if it is too long."""
    body = pack_map(message)
    if len(body) > LONGEST:
        raise ProtocolError(f"a message of {len(body)} bytes was to be sent, wanted at most {LONGEST}")
    return LENGTH.pack(len(body)) + body


def unpack(body: bytes | bytearray) -> Message:
    """The map in the body of a message. Raises ProtocolError for anything else."""
    message = read_map(body, "a message", LIMITS)
    _check_plain(message)
    return message


def _check_plain(value: Message | list[Any]) -> None:
    for inner in value.values() if isinstance(value, dict) else value:
        if isinstance(inner, dict | list):
            _check_plain(inner)
        elif not isinstance(inner, PLAIN):  # msgpack lets a string of no bytes pass
            raise ProtocolError(f"a message came with {type(inner).__name__}, wanted plain text and numbers")


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
