"""Interprets formulas with numpy: `Lanes` are numpy's numbers or arrays, so that a debugger can step through a formula.

One operation of numpy rounds as one of LLVM does; whole numbers run over silently in both.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.node.jit.lanes import BIT, F64, FLOATS, I64, Declared, FlatArray, Lanes, Memory, Number, mapped

_DTYPES = {name: np.dtype(name) for name in ("float64", "float32", "int64", "int32", "uint8", "bool")}
_BITS_OF = {"float64": "int64", "float32": "int32"}
_DONE: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "shl": np.left_shift,
}
_COMPARED: dict[str, Callable[..., Any]] = {
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
    "==": np.equal,
}
_CALLED: dict[str, Callable[..., Any]] = {
    "sqrt": np.sqrt,
    "fabs": np.fabs,
    "floor": np.floor,
    "ceil": np.ceil,
    "trunc": np.trunc,
    "copysign": np.copysign,
}


class NumpyLanes(Lanes):
    """Numbers in an array of numpy, of any shape."""

    def __init__(self, value: Any, kind: str) -> None:
        self.value: NDArray[Any] = np.asarray(value, _DTYPES[kind])
        self.kind = kind

    def _of(self, value: Any, kind: str | None = None) -> NumpyLanes:
        return NumpyLanes(value, kind or self.kind)

    def _same(self, other: Number) -> NDArray[Any]:
        if isinstance(other, NumpyLanes):
            if other.kind != self.kind:
                raise TypeError(f"{self.kind} meets {other.kind} in a formula")
            return other.value
        return np.asarray(other, _DTYPES[self.kind])

    def _do(self, operation: str, other: Number) -> Lanes:
        if operation != "shr":
            return self._of(_DONE[operation](self.value, self._same(other)))
        unsigned = self.value.dtype.str.replace("i", "u")  # the bits move, not the sign
        return self._of((self.value.view(unsigned) >> self._same(other).astype(unsigned)).view(self.value.dtype))

    def _compare(self, operator: str, other: Number) -> Lanes:
        return self._of(_COMPARED[operator](self.value, self._same(other)), BIT)

    def _call(self, name: str, *others: Lanes) -> Lanes:
        return self._of(_CALLED[name](self.value, *map(self._same, others)))

    def every(self, one: float) -> Lanes:
        return self._of(one)

    def __neg__(self) -> Lanes:
        return self._of(np.negative(self.value))

    def choose(self, yes: Number, no: Number) -> Lanes:
        alike = next((one for one in (yes, no) if isinstance(one, NumpyLanes)), NumpyLanes(0, I64))
        return alike._of(np.where(self.value, alike._same(yes), alike._same(no)))

    def lacks(self, other: Lanes) -> Lanes:
        return self._of(self.value & ~self._same(other))

    def to(self, kind: str) -> Lanes:
        return self._of(self.value.astype(_DTYPES[kind]), kind)

    def bits(self) -> Lanes:
        return self._of(self.value.view(_BITS_OF[self.kind]), _BITS_OF[self.kind])

    def of_bits(self) -> Lanes:
        return self._of(self.value.view(F64), F64)

    def lowest_bit(self) -> Lanes:
        width = 8 * self.value.dtype.itemsize
        alone = (self.value & -self.value).astype(F64)
        return self._of(np.where(self.value == 0, width, np.frexp(np.abs(alone))[1] - 1))


class NumpyMemory(Memory):
    """A contiguous array, of which so many numbers are read at once."""

    def __init__(self, array: NDArray[Any], lanes: int) -> None:
        if not array.flags.c_contiguous:
            raise TypeError("an array of a formula must be contiguous")
        self._array, self._lanes = array.reshape(-1), lanes

    def _checked(self, place: Lanes | int, many: int) -> int:
        at = int(place.value) if isinstance(place, NumpyLanes) else int(place)  # type: ignore[arg-type]
        if at < 0 or at + many > len(self._array):
            raise IndexError(f"places {at}..{at + many - 1} of an array of {len(self._array)}")
        return at

    def one(self, place: Lanes | int) -> Lanes:
        return NumpyLanes(self._array[self._checked(place, 1)], str(self._array.dtype))

    def read(self, place: Lanes | int) -> Lanes:
        at = self._checked(place, self._lanes)
        return NumpyLanes(self._array[at : at + self._lanes].copy(), str(self._array.dtype))

    def write(self, place: Lanes | int, lanes: Lanes) -> None:
        at = self._checked(place, self._lanes)
        assert isinstance(lanes, NumpyLanes)
        if lanes.kind != str(self._array.dtype):
            raise TypeError(f"{lanes.kind} is written to an array of {self._array.dtype}")
        self._array[at : at + self._lanes] = lanes.value

    def append(self, place: Lanes, lanes: Lanes, chosen: Lanes) -> Lanes:
        assert isinstance(lanes, NumpyLanes) and isinstance(chosen, NumpyLanes)
        at, which = self._checked(place, self._lanes), np.broadcast_to(chosen.value, lanes.value.shape)
        kept = lanes.value[which]
        self._array[at : at + self._lanes] = np.concatenate([kept, lanes.value[~which]])
        return NumpyLanes(len(kept), I64)

    def numbered(self, place: Lanes) -> Lanes:
        return place + NumpyLanes(np.arange(self._lanes), I64)


def interpret(
    staged: Callable[..., Any], takes: tuple[Declared, ...], gives: Declared, arguments: tuple[Any, ...], lanes: int
) -> Any:
    """Run a formula on numbers of Python or numpy, and arrays of them; returns numbers of numpy, or truths.

    lanes  how many numbers are read from memory at once. Raises TypeError for other arguments than it takes.
    """

    def given(declared: Declared, value: Any) -> Any:
        if isinstance(declared, FlatArray):
            return NumpyMemory(value, lanes)
        if np.asarray(value).dtype.kind not in ("fiub" if declared in FLOATS else "iub"):
            raise TypeError(f"came {value!r}, wanted {declared}")
        return NumpyLanes(value, declared)

    def taken(declared: str, value: Any) -> Any:
        numbers = (value if isinstance(value, Lanes) else NumpyLanes(value, declared)).to(declared).value  # type: ignore[attr-defined]
        return numbers if numbers.shape else numbers[()]

    with np.errstate(all="ignore"):
        result = staged(*(mapped(given, *each) for each in zip(takes, arguments, strict=True)))
    return None if gives is None else mapped(taken, gives, result)
