"""Instructions that numba lacks: what they give, and that they are written for a llvmlite whose pointers have no types."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from llvmlite import ir
from numba import njit

from raygrid.node.jit import intrinsics
from raygrid.node.jit.intrinsics import (
    address,
    bytes_at,
    call_int,
    call_long,
    copy_bytes,
    load_8,
    load_16,
    load_32,
    load_64,
    put_words,
)

needs_a_compiler = pytest.mark.skipif(bool(intrinsics.config.DISABLE_JIT), reason="compiles with NUMBA_DISABLE_JIT=0")
Asked = Callable[[tuple[Any, ...], dict[str, Any]], bool]


@pytest.fixture
def pointers_without_types(monkeypatch):
    """For the code of intrinsics llvmlite's pointers have no types: what would need one is refused.

    Not for numba's own, which still gives pointers types and reads them.
    """
    asked = []

    def refuse_unless(owner: Any, name: str, has: Asked) -> None:
        method = getattr(owner, name)

        def guarded(self: Any, *arguments: Any, **options: Any) -> Any:
            if sys._getframe(1).f_globals.get("__name__") == intrinsics.__name__:
                asked.append(name)
                assert has(arguments, options), f"{name} relies on the type of a pointer"
            return method(self, *arguments, **options)

        monkeypatch.setattr(owner, name, guarded)

    refuse_unless(ir.IRBuilder, "gep", lambda given, named: "source_etype" in named and given[0].type.is_opaque)
    refuse_unless(ir.IRBuilder, "load", lambda given, named: "typ" in named and given[0].type.is_opaque)
    refuse_unless(ir.IRBuilder, "store", lambda given, _: given[1].type.is_opaque)
    refuse_unless(ir.IRBuilder, "inttoptr", lambda given, _: given[1].is_opaque)
    refuse_unless(ir.Type, "as_pointer", lambda given, named: False)
    return asked


def compiled(function):
    return njit(_nrt=False, error_model="numpy")(function)


def of_c(name):
    return ctypes.cast(getattr(ctypes.CDLL(None), name), ctypes.c_void_p).value


def in_python(name):
    return intrinsics.DEFINED[name][1]


@given(arrays(np.uint8, 24), st.integers(0, 16))
def test_bytes_are_read_as_words(raw, at):
    names = ("load_8", "load_16", "load_32", "load_64")
    assert read(raw, at) == tuple(in_python(name)(raw, at) for name in names)
    wanted = [int.from_bytes(raw[at : at + size].tobytes(), "little") for size in (1, 2, 4)]
    assert read(raw, at) == (*wanted, int.from_bytes(raw[at : at + 8].tobytes(), "little", signed=True))


@compiled
def read(raw, at):
    return load_8(raw, at), load_16(raw, at), load_32(raw, at), load_64(raw, at)


@compiled
def put(raw, at, first, second, third):
    put_words(raw, at, first, second, third)


@given(*[st.integers(-(2**63), 2**63 - 1)] * 3, st.integers(0, 6))
def test_words_are_put_where_they_belong_and_nowhere_else(first, second, third, at):
    for way in (put, in_python("put_words")):
        raw = np.full(30, 7, np.uint8)
        way(raw, at, first, second, third)
        assert raw[at : at + 24].view(np.int64).tolist() == [first, second, third]
        assert raw[:at].tolist() + raw[at + 24 :].tolist() == [7] * 6


@compiled
def copy(source, at, target, to, size):
    copy_bytes(source, at, target, to, size)


@pytest.mark.parametrize("way", [copy, in_python("copy_bytes")], ids=["compiled", "interpreted"])
def test_bytes_are_copied(way):
    target = np.zeros(6, np.uint8)
    way(np.arange(10, 20, dtype=np.uint8), 2, target, 1, 3)
    assert target.tolist() == [0, 12, 13, 14, 0, 0]
    way(np.arange(10, 20, dtype=np.uint8), 10, target, 6, 0)
    assert target.tolist() == [0, 12, 13, 14, 0, 0]


@compiled
def place(array, index):
    return address(array, index)


@pytest.mark.parametrize("kind", ["u1", "i8", [("one", "i8"), ("other", "f4")]])
@pytest.mark.parametrize("way", [place, in_python("address")], ids=["compiled", "interpreted"])
def test_an_address_is_that_of_the_element(way, kind):
    array = np.zeros(5, np.dtype(kind))
    assert way(array, 3) == array.ctypes.data + 3 * array.itemsize


@compiled
def call(length, size, text):
    seen = bytes_at(text, call_long(length, (text,)))
    return call_int(size, (np.int64(-5),)), len(seen), seen[0], seen[len(seen) - 1]


def test_functions_are_called_by_address_and_bytes_seen_by_theirs():
    text = ctypes.create_string_buffer(b"raygrid")
    assert call(of_c("strlen"), of_c("abs"), ctypes.addressof(text)) == (5, 7, ord("r"), ord("d"))
    length = in_python("call_long")(of_c("strlen"), (ctypes.addressof(text),))
    assert in_python("bytes_at")(ctypes.addressof(text), length).tobytes() == b"raygrid"
    assert in_python("call_int")(of_c("abs"), (np.int64(-5),)) == 5


@needs_a_compiler
def test_none_relies_on_the_types_of_pointers(pointers_without_types):
    raw, text = np.zeros(40, np.uint8), ctypes.create_string_buffer(b"raygrid")
    for function, arguments in (
        (read, (raw, 0)),
        (put, (raw, 0, 1, 2, 3)),
        (copy, (raw, 0, raw[20:], 0, 3)),
        (place, (raw, 3)),
        (call, (of_c("strlen"), of_c("abs"), ctypes.addressof(text))),
    ):
        njit(_nrt=False, error_model="numpy")(function.py_func)(*arguments)  # compiled anew
    assert {name: pointers_without_types.count(name) for name in ("gep", "load", "store", "inttoptr")} == {
        "gep": 10,
        "load": 4,
        "store": 3,
        "inttoptr": 3,
    }


# what would be read or written outside -> the call that would
OUTSIDE = {
    "a word before an array": (read, (np.zeros(8, np.uint8), -1)),
    "a word that ends behind it": (read, (np.zeros(8, np.uint8), 1)),
    "words behind it": (put, (np.zeros(23, np.uint8), 0, 1, 2, 3)),
    "bytes that are not there": (copy, (np.zeros(4, np.uint8), 2, np.zeros(9, np.uint8), 0, 3)),
    "bytes for which there is no room": (copy, (np.zeros(9, np.uint8), 0, np.zeros(4, np.uint8), 2, 3)),
    "the address of no element": (place, (np.zeros(4, np.int64), 5)),
}


@needs_a_compiler
@pytest.mark.parametrize("what", OUTSIDE)
def test_where_bounds_are_checked_so_are_places(monkeypatch, what):
    monkeypatch.setattr(intrinsics.config, "BOUNDSCHECK", 1)
    function, arguments = OUTSIDE[what]
    with pytest.raises(IndexError, match="out of bounds"):
        njit(_nrt=False, error_model="numpy")(function.py_func)(*arguments)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("load_8", (np.zeros(8, np.uint8), -1)),
        ("load_64", (np.zeros(8, np.uint8), 1)),
        ("put_words", (np.zeros(23, np.uint8), 0, 1, 2, 3)),
        ("copy_bytes", (np.zeros(9, np.uint8), 0, np.zeros(4, np.uint8), 2, 3)),
        ("address", (np.zeros(4), 5)),
    ],
)
def test_in_python_they_always_are(name, arguments):
    with pytest.raises(IndexError, match="out of bounds"):
        in_python(name)(*arguments)


def test_without_a_compiler_they_are_python():
    look = "from raygrid.node.jit import intrinsics as i; assert i.load_8 is i.DEFINED['load_8'][1]"
    subprocess.run([sys.executable, "-c", look], check=True, timeout=60, env=os.environ | {"NUMBA_DISABLE_JIT": "1"})
