"""Reads the environment variables that turn fast paths off: with each of them 0 the same is done another way, and slower.

They are looked at when a process begins, and the processes of an array inherit them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import NamedTuple

from raygrid.node.remarks import remark


class Switch(NamedTuple):
    """A variable of the environment: 0 turns a fast path off; 1, nothing, or no variable leaves it on.

    changes_code  whether kernels are compiled to other machine code without it, so that they are kept apart
    """

    variable: str
    changes_code: bool = False


FAST_LOAD = Switch("RAYGRID_FAST_LOAD")  # node.jit.fast_load
NATIVE_LINKS = Switch("RAYGRID_NATIVE_LINKS")  # node.links.zmq_c_api, node.runtime.native_links
SIMD = Switch("RAYGRID_SIMD", changes_code=True)  # node.jit.formula
SWITCHES = (FAST_LOAD, NATIVE_LINKS, SIMD)


def why_off(switch: Switch, tell: Callable[[str, str], None] = remark) -> str | None:
    """Say why a fast path is turned off; None if it is on. A value that says neither is told once, and leaves it on."""
    value = os.environ.get(switch.variable, "")
    if value == "0":
        return f"{switch.variable}=0 asks for it"
    if value not in ("", "1"):
        tell(switch.variable, f"{switch.variable} came as {value!r}, wanted 0 or 1: it stays on")
    return None


def code_state() -> tuple[str, ...]:
    """The variables that are off and of which the machine code depends, for whoever keeps it."""
    return tuple(one.variable for one in SWITCHES if one.changes_code and why_off(one) is not None)
