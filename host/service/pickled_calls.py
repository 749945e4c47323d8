"""Packs calls and answers between the service and its scribe: pickles, with large arrays beside them uncopied.

    +-------------------+---------------------------+--------+-------------+
    | count, u64 little | count lengths, u64 each   | pickle | its buffers |
    +-------------------+---------------------------+--------+-------------+

Both sides are ours and trust each other. Objects of SHARED types travel once: afterwards only their number does, and what
comes out is the same object, by which an array knows that it holds the surfaces of the frame before.
"""

from __future__ import annotations

import io
import pickle
import struct
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

MOST_SHARED = 16  # objects that are kept on either side
WORD = struct.Struct("<Q")

Reference = tuple[int, tuple[object] | None]  # the number of a shared object; with the object where it goes first


class Shared:
    """Objects that both sides keep, by the number under which they went. Both keep and forget in the same order."""

    def __init__(self, types: tuple[type, ...]) -> None:
        self.types = types
        self._held: OrderedDict[int, object] = OrderedDict()
        self._number = 0

    def number_of(self, value: object) -> int | None:
        """The number of an object that went before."""
        return next((number for number, held in self._held.items() if held is value), None)

    def keep(self, value: object) -> int:
        """Keep one that goes for the first time."""
        self._number += 1
        self._held[self._number] = value
        while len(self._held) > MOST_SHARED:
            self._held.popitem(last=False)
        return self._number

    def use(self, number: int) -> object:
        """One that was kept, which counts as used last."""
        self._held.move_to_end(number)
        return self._held[number]


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, shared: Shared, buffers: list[pickle.PickleBuffer]) -> None:
        super().__init__(file, 5, buffer_callback=lambda buffer: buffers.append(buffer))
        self._shared = shared
        self._whole: object = None  # goes in full

    def persistent_id(self, value: object) -> Reference | None:
        """Numbers for what is shared; with the object itself where it goes for the first time."""
        if not isinstance(value, self._shared.types) or value is self._whole:
            return None
        number = self._shared.number_of(value)
        if number is not None:
            self._shared.use(number)
            return number, None
        self._whole = value
        return self._shared.keep(value), (value,)


class _Unpickler(pickle.Unpickler):
    def __init__(self, data: bytes | bytearray, shared: Shared, buffers: list[bytearray]) -> None:
        super().__init__(io.BytesIO(data), buffers=buffers)
        self._shared = shared

    def persistent_load(self, reference: Reference) -> object:
        """The object of a reference."""
        number, new = reference
        if new is None:
            return self._shared.use(number)
        self._shared.keep(new[0])
        return new[0]


def pack(value: object, shared: Shared) -> list[memoryview]:
    """A message as pieces of bytes to be sent in order; arrays are not copied."""
    buffers: list[pickle.PickleBuffer] = []
    file = io.BytesIO()
    _Pickler(file, shared, buffers).dump(value)
    pieces = [file.getbuffer(), *(buffer.raw() for buffer in buffers)]
    head = WORD.pack(len(pieces)) + b"".join(WORD.pack(piece.nbytes) for piece in pieces)
    return [memoryview(head), *(piece for piece in pieces if piece.nbytes)]


def receive(shared: Shared, read: Callable[[memoryview], int]) -> Any:
    """Take in one message. Raises EOFError if nothing more comes, and what `read` raises.

    read  waits for bytes and puts them at the beginning of a piece of memory; returns how many, 0: nothing more comes
    """

    def whole(size: int) -> bytearray:
        piece = bytearray(size)
        room = memoryview(piece)
        while room:
            count = read(room)
            if not count:
                raise EOFError
            room = room[count:]
        return piece

    (count,) = WORD.unpack(whole(WORD.size))
    pieces = [whole(length) for (length,) in WORD.iter_unpack(whole(WORD.size * count))]
    return _Unpickler(pieces[0], shared, pieces[1:]).load()
