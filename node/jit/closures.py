"""Names functions that are made within another one, so that their machine code can be told apart and kept.

The ray step is made of its parts (`node.tracing.step.make_step`), and a function that is made twice of different parts has
one text and one name. But machine code is linked by name, and kept by name and text. numba would pickle what a function
holds to tell it apart, and of a compiled function that is another sequence of bytes in every process: nothing kept would be
found again. So such a function gets a name that holds a digest of what it holds.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from typing import Any

# Makes a function of the same parts once. Only the last few steps are kept, as a service may load one program after the
# other; what is a program's own stays with its module (`node.programs.programs`).
made_of_parts = lru_cache(maxsize=8)
_DIGITS = 12  # hexadecimal, of the digest


def name_closure(function: Callable[..., Any]) -> None:
    """Add to the name of a function what it holds, if it was made within another one."""
    if function.__closure__:
        digest = hashlib.sha256("; ".join(_words(function)).encode()).hexdigest()[:_DIGITS]
        function.__qualname__ = f"{function.__qualname__}_{digest}"


def _words(function: Callable[..., Any]) -> list[str]:
    """What a function holds, in words that are the same in every process. Raises TypeError for what has none."""
    return [_word(cell.cell_contents) for cell in function.__closure__ or ()]


def _word(held: Any) -> str:
    function = getattr(held, "py_func", held)  # of a kernel the function that it was made of
    if callable(function) and hasattr(function, "__qualname__"):
        return f"{function.__module__}.{function.__qualname__}"
    if isinstance(held, bool | int | float | str):
        return repr(held)
    raise TypeError(f"a compiled function holds {held!r}, wanted functions and numbers")
