"""Cuts a stream of bytes into messages, each of which stands behind its length.

+--------------------+------+
| length, u32 little | body |
+--------------------+------+
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Generic, TypeVar

from raygrid.node.errors import ProtocolError

T = TypeVar("T")
LENGTH = struct.Struct("<I")


def framed(body: bytes) -> bytes:
    """A body behind its length."""
    return LENGTH.pack(len(body)) + body


class Splitter(Generic[T]):
    """Cuts a stream of bytes into messages. The length is checked before it is waited for.

    read      makes a message of its body; may raise ProtocolError
    longest   bytes of the longest body that is taken; may be changed between messages
    """

    def __init__(self, read: Callable[[bytes], T], longest: int) -> None:
        self._read, self.longest = read, longest
        self._held = bytearray()

    @property
    def held(self) -> int:
        """Bytes of a message that has not come whole."""
        return len(self._held)

    def feed(self, piece: bytes) -> None:
        """Take in what has come."""
        self._held += piece

    def next(self) -> T | None:
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
        return self._read(body)
