"""Says for which processor numba compiles, and where it would keep a function: for people, not for kernels."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

from llvmlite import binding as _binding
from numba.core import caching as _caching
from numba.core import codegen as _codegen
from numba.core import config as _config

binding: Any = _binding
caching: Any = _caching
codegen: Any = _codegen
config: Any = _config

# of x86, the best first -> bits of a register
INSTRUCTIONS = {"avx512f": 512, "avx2": 256, "avx": 256}
PLAIN_BITS = 128  # of every other processor


class Target(NamedTuple):
    """A processor.

    instructions  the best of INSTRUCTIONS that it has, None if it has none; bits: of its registers
    why           what keeps numba from better ones; None if there are some
    """

    name: str
    instructions: str | None
    bits: int
    why: str | None


def read_target() -> Target:
    """The processor for which kernels are compiled."""
    chosen = config.CPU_FEATURES
    features = codegen.get_host_cpu_features() if chosen is None else chosen
    has = {name[1:] for name in features.split(",") if name.startswith("+")}
    best = next((name for name in INSTRUCTIONS if name in has), None)
    name = config.CPU_NAME or binding.get_host_cpu_name()
    if best is not None:
        return Target(name, best, INSTRUCTIONS[best], None)
    if chosen is not None:
        why = "NUMBA_CPU_NAME or NUMBA_CPU_FEATURES asks for it"
    elif not config.ENABLE_AVX and os.uname().machine in ("x86_64", "i686"):
        why = "NUMBA_ENABLE_AVX=0, or numba knows this processor to be slow with AVX"
    else:
        why = "the processor has no wider ones"
    return Target(name, None, PLAIN_BITS, why)


def why_interpreted() -> str | None:
    """Say why kernels are not compiled; None if they are."""
    return "NUMBA_DISABLE_JIT asks for it" if config.DISABLE_JIT else None


def kept_in(source: str) -> str:
    """Name the folder of the cache that has the kernels of a source file."""
    return str(caching._CacheLocator.get_suitable_cache_subpath(source))
