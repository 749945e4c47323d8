"""Finds the C functions of ZeroMQ that links need, and of a checksum, for calls from compiled code by their addresses.

An address is a number handed in when a kernel is called, so that compiled code stays good for other processes and
can be kept on disk. Who has no such functions (another build of pyzmq or xxhash) gets no addresses, and the links are
served by Python alone: slower, and the same in all else. With RAYGRID_NATIVE_LINKS=0 in the environment nobody has any.
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

from raygrid.node.jit.records import Record, Rows, record, with_attributes
from raygrid.node.jit.switches import NATIVE_LINKS, why_off

MESSAGE_WORDS = 8  # of a zmq_msg_t, which has 64 bytes and wants to begin at a multiple of 8

_FROM_ZEROMQ = {
    "message_init": "zmq_msg_init",
    "message_receive": "zmq_msg_recv",
    "message_data": "zmq_msg_data",
    "message_size": "zmq_msg_size",
    "message_more": "zmq_msg_more",
    "message_close": "zmq_msg_close",
    "send": "zmq_send",
    "poll": "zmq_poll",
    "error": "zmq_errno",
}
# the first also looks which instructions the processor has, where it can (x86)
_CHECKSUMS = ("XXH3_64bits_withSeed_dispatch", "XXH3_64bits_withSeed")
_SLEEP, _CLOCK = "usleep", "clock_gettime"
OLD_SWITCH, BY_PYTHON = "RAYGRID_LINKS", "python"  # what RAYGRID_NATIVE_LINKS=0 was called at first
# a zmq_pollitem_t: address of a socket (0: none), else a descriptor; events that are wanted and that were found
POLL_ITEM = with_attributes(np.dtype([("socket", "i8"), ("descriptor", "i4"), ("wanted", "i2"), ("found", "i2")]))


@record
class CFunctions(Record):
    """Addresses of C functions, and what else compiled code needs to call them.

    message  address of the room for a message that is received (`ReceivedMessage`)
    again    the error number that says that nothing can be received or sent now
    """

    message_init: int
    message_receive: int
    message_data: int
    message_size: int
    message_more: int
    message_close: int
    send: int
    poll: int
    error: int
    checksum: int
    sleep: int
    clock: int
    message: int
    again: int


def _address_of(library: ctypes.CDLL, name: str) -> int:
    return int(ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0)


def _library_of(module: str) -> ctypes.CDLL:
    return ctypes.CDLL(importlib.import_module(module).__file__)


def find_functions() -> CFunctions | None:
    """The addresses, without a message; None if one cannot be found.

    To be copied. A fork finds them where its parent did.
    """
    return _look_for_functions()[0]


def find_clock() -> int:
    """The address of `clock_gettime`, 0 if the C library has none."""
    library = ctypes.CDLL(None)
    return _address_of(library, _CLOCK) if hasattr(library, _CLOCK) else 0


def why_python() -> str | None:
    """Why Python alone serves the links; None where compiled code does."""
    return _look_for_functions()[1]


@cache
def _look_for_functions() -> tuple[CFunctions | None, str | None]:
    """The addresses, or why there are none."""
    found = CFunctions()
    off = why_off(NATIVE_LINKS)
    if off is None and os.environ.get(OLD_SWITCH) == BY_PYTHON:
        off = f"{OLD_SWITCH}={BY_PYTHON} asks for it"
    if off is not None:
        return None, off
    if sys.byteorder != "little":  # of `poll_items`
        return None, "numbers begin with their highest byte on this computer"
    try:
        library = _library_of("zmq.backend.cython._zmq")  # a name is looked for in what it was linked with, too
        for place, name in _FROM_ZEROMQ.items():
            setattr(found, place, _address_of(library, name))
        library = _library_of("xxhash._xxhash")
        names = [name for name in _CHECKSUMS if hasattr(library, name)]
        found.checksum = _address_of(library, names[0])
        found.sleep, found.clock = (_address_of(ctypes.CDLL(None), name) for name in (_SLEEP, _CLOCK))
    except (ImportError, AttributeError, IndexError, OSError) as error:
        missing = "no checksum of xxhash" if isinstance(error, IndexError) else str(error)
        return None, f"a C function of pyzmq or xxhash cannot be found: {missing}"
    found.again = int(zmq.EAGAIN)
    return found, None


def poll_items(sockets: Iterable[int], descriptors: Iterable[int]) -> Rows:
    """What `zmq_poll` is to wait for, POLL_ITEM (n,): sockets of these addresses, and descriptors, with something to read."""
    wanted = int(zmq.POLLIN)
    items = [(socket, 0, wanted, 0) for socket in sockets] + [(0, one, wanted, 0) for one in descriptors]
    return np.array(items, POLL_ITEM)


class ReceivedMessage:
    """Room for one message of ZeroMQ, into which compiled code receives; Python can read what it left there."""

    def __init__(self, functions: CFunctions) -> None:
        self._words = np.zeros(MESSAGE_WORDS, np.int64)
        functions.message = self._words.ctypes.data
        self._place = ctypes.c_void_p(self._words.ctypes.data)
        prototype = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
        self._data = prototype(functions.message_data)
        self._length = ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.c_void_p)(functions.message_size)
        number = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
        self._more, self._close = number(functions.message_more), number(functions.message_close)
        number(functions.message_init)(self._place)

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
