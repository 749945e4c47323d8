"""How a compiled kernel is loaded from the cache on disk: without waking all of numba's compiler.

numba's own cache first makes the compiler ready, whatever comes (`BaseContext.refresh`: it imports and registers all
that could be compiled, a quarter of a second, and scipy if it is installed), and then looks whether the kernel is there. But
machine code only needs the addresses of the functions that it calls. So their names are kept beside it, and a kernel
is loaded without the compiler if each of them has an address; if not, the compiler is made ready first, as numba would have
done. Only a kernel that is not on disk needs it in any case, also after others were loaded without.

numba documents none of this. So every name that is used here is looked for first, and the steps of numba's own `load_overload`
are compared with those that are known; where anything differs, kernels are cached by numba alone.

A cache looks for its directory when it is first used, not when its function is decorated: nine of ten functions are only
parts of kernels, and are never loaded.
"""

from __future__ import annotations

import functools
import inspect
from typing import Any

from llvmlite import binding as _binding
from numba.core import caching as _caching
from numba.core import config as _config

from .kernel_cache import DirectoryName, in_directory

binding: Any = _binding
caching: Any = _caching
config: Any = _config

# What numba's `Cache.load_overload` calls, and what it hands on.
_STEPS = {"refresh", "_guard_against_spurious_io_errors", "_load_overload"}
_SHAPES = (
    ("Cache", "load_overload", ["self", "sig", "target_context"]),
    ("Cache", "_load_overload", ["self", "sig", "target_context"]),
    ("CompileResultCacheImpl", "reduce", ["self", "cres"]),
    ("CompileResultCacheImpl", "rebuild", ["self", "target_context", "payload"]),
)


@functools.cache
def can_load_alone() -> bool:
    """Whether this numba is one whose kernels can be loaded without its compiler."""
    try:
        for kind, method, wanted in _SHAPES:
            if list(inspect.signature(getattr(getattr(caching, kind), method)).parameters) != wanted:
                return False
        known = caching.FunctionCache.load_overload is caching.Cache.load_overload
        known = known and set(caching.Cache.load_overload.__code__.co_names) == _STEPS
        return known and not config.NRT_STATS and _have_runtime()
    except (AttributeError, ImportError, TypeError, ValueError):
        return False


@functools.cache
def _have_runtime() -> bool:
    """Make known to the linker what numba's runtime offers to machine code, as `rtsys.initialize` does."""
    from numba.core.runtime import _nrt_python

    helpers: dict[str, int] = _nrt_python.c_helpers
    for name, address in helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
    return bool(helpers)


def needed_names(compiled: Any) -> tuple[str, ...]:
    """The names that a compile result's machine code wants from outside, sorted."""
    module = compiled.library._final_module
    outside = [one.name for ones in (module.functions, module.global_variables) for one in ones if one.is_declaration]
    return tuple(sorted(name for name in outside if not name.startswith("llvm.")))


if can_load_alone():

    class _Payload(caching.CompileResultCacheImpl):  # type: ignore[misc]
        """What is kept of a kernel: the names that it wants, and what numba keeps."""

        def reduce(self, cres: Any) -> tuple[tuple[str, ...], Any]:
            return needed_names(cres), super().reduce(cres)

        def rebuild(self, target_context: Any, payload: Any) -> Any:
            names, kept = payload
            if not all(map(binding.address_of_symbol, names)):
                target_context.refresh()
            return super().rebuild(target_context, kept)

    class _Alone(caching.FunctionCache):  # type: ignore[misc]
        """numba's cache of a function, that looks first."""

        _impl_class = _Payload

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            with self._guard_against_spurious_io_errors():
                found = self._load_overload(sig, target_context)
                if found is not None:
                    return found
            return super().load_overload(sig, target_context)


class LazyCache:
    """The cache of a function, in a directory as of `kernel_cache`; what numba asks of a cache, handed on to one."""

    def __init__(self, function: Any, directory: DirectoryName) -> None:
        self._function, self._directory = function, directory

    @functools.cached_property
    def _cache(self) -> Any:
        with in_directory(self._directory):
            return (_Alone if can_load_alone() else caching.FunctionCache)(self._function)

    @property
    def cache_path(self) -> str:
        """Where its files are."""
        path: str = self._cache.cache_path
        return path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function for these types, None if it is not on disk."""
        return self._cache.load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function."""
        self._cache.save_overload(sig, data)

    def enable(self) -> None:
        """As of numba's caches."""
        self._cache.enable()

    def disable(self) -> None:
        """As of numba's caches."""
        self._cache.disable()

    def flush(self) -> None:
        """Forget what is on disk."""
        self._cache.flush()
