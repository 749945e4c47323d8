"""The C functions of ZeroMQ that links need, and of a checksum, for calls from compiled code by their addresses.

An address is a number handed in when a kernel is called, so that compiled code stays good for other processes and
can be kept on disk. Who has no such functions (another build of pyzmq or xxhash) gets no addresses, and the links are
served by Python alone: slower, and the same in all else. With RAYGRID_LINKS=python in the environment nobody has any.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import sys
from collections.abc import Iterable
from functools import cache

import numpy as np
import zmq
from numpy.typing import NDArray

# places in the table of addresses
(
    ZMQ_INITIALIZE,
    ZMQ_RECEIVE,
    ZMQ_DATA,
    ZMQ_LENGTH,
    ZMQ_MORE,
    ZMQ_CLOSE,
    ZMQ_SEND,
    ZMQ_POLL,
    ZMQ_ERROR,
    HASH,
    MESSAGE,
    ZMQ_AGAIN,
    SLEEP,
    CLOCK,
) = range(14)
ADDRESSES = 14
MESSAGE_WORDS = 8  # of a zmq_msg_t, which has 64 bytes and wants to begin at a multiple of 8

_FROM_ZEROMQ = {
    ZMQ_INITIALIZE: "zmq_msg_init",
    ZMQ_RECEIVE: "zmq_msg_recv",
    ZMQ_DATA: "zmq_msg_data",
    ZMQ_LENGTH: "zmq_msg_size",
    ZMQ_MORE: "zmq_msg_more",
    ZMQ_CLOSE: "zmq_msg_close",
    ZMQ_SEND: "zmq_send",
    ZMQ_POLL: "zmq_poll",
    ZMQ_ERROR: "zmq_errno",
}
# the first also looks which instructions the processor has, where it can (x86)
_CHECKSUMS = ("XXH3_64bits_withSeed_dispatch", "XXH3_64bits_withSeed")
_SLEEP, _CLOCK = "usleep", "clock_gettime"
SWITCH, BY_PYTHON = "RAYGRID_LINKS", "python"


def _address_of(library: ctypes.CDLL, name: str) -> int:
    return int(ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0)


def _library_of(module: str) -> ctypes.CDLL:
    return ctypes.CDLL(importlib.import_module(module).__file__)


def find_functions() -> NDArray[np.int64] | None:
    """The table of addresses, int64 (ADDRESSES,), without a message; None if one cannot be found.

    To be copied. A fork finds them where its parent did.
    """
    return _look_for_functions()[0]


def why_python() -> str | None:
    """Why Python alone serves the links; None where compiled code does."""
    return _look_for_functions()[1]


@cache
def _look_for_functions() -> tuple[NDArray[np.int64] | None, str | None]:
    """The table, or why there is none."""
    table = np.zeros(ADDRESSES, np.int64)
    if os.environ.get(SWITCH) == BY_PYTHON:
        return None, f"{SWITCH}={BY_PYTHON} asks for it"
    if sys.byteorder != "little":  # of `poll_items`
        return None, "numbers begin with their highest byte on this computer"
    try:
        library = _library_of("zmq.backend.cython._zmq")  # a name is looked for in what it was linked with, too
        for place, name in _FROM_ZEROMQ.items():
            table[place] = _address_of(library, name)
        library = _library_of("xxhash._xxhash")
        names = [name for name in _CHECKSUMS if hasattr(library, name)]
        table[HASH] = _address_of(library, names[0])
        table[SLEEP], table[CLOCK] = (_address_of(ctypes.CDLL(None), name) for name in (_SLEEP, _CLOCK))
    except (ImportError, AttributeError, IndexError, OSError) as error:
        missing = "no checksum of xxhash" if isinstance(error, IndexError) else str(error)
        return None, f"a C function of pyzmq or xxhash cannot be found: {missing}"
    table[ZMQ_AGAIN] = int(zmq.EAGAIN)
    return table, None


def poll_items(sockets: Iterable[int], descriptors: Iterable[int]) -> NDArray[np.int64]:
    """What `zmq_poll` is to wait for, int64 (n, 2): sockets of these addresses, and descriptors, with something to read.

    An item is a zmq_pollitem_t: address of a socket; descriptor (32 bits), wanted events, found events (16 bits each).
    """
    wanted = int(zmq.POLLIN) << 32
    rows = [(socket, wanted) for socket in sockets] + [(0, wanted | one) for one in descriptors]
    return np.array(rows, np.int64).reshape(-1, 2)


class ReceivedMessage:
    """Room for one message of ZeroMQ, into which compiled code receives; Python can read what it left there."""

    def __init__(self, table: NDArray[np.int64]) -> None:
        self._words = np.zeros(MESSAGE_WORDS, np.int64)
        table[MESSAGE] = self._words.ctypes.data
        self._place = ctypes.c_void_p(self._words.ctypes.data)
        prototype = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
        self._data = prototype(int(table[ZMQ_DATA]))
        self._length = ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.c_void_p)(int(table[ZMQ_LENGTH]))
        number = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
        self._more, self._close = number(int(table[ZMQ_MORE])), number(int(table[ZMQ_CLOSE]))
        number(int(table[ZMQ_INITIALIZE]))(self._place)

    def copy(self) -> bytes:
        """The bytes of the message that was received last."""
        return ctypes.string_at(self._data(self._place), self._length(self._place))

    def close(self) -> None:
        """Give back what ZeroMQ holds for it. Nothing may be received into it afterwards."""
        self._close(self._place)

    @property
    def has_more(self) -> bool:
        """Whether it is but a part of a message."""
        return bool(self._more(self._place))
