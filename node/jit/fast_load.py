"""Loads a compiled kernel from the cache on disk without waking all of numba's compiler.

numba's own cache first makes the compiler ready, whatever comes (`BaseContext.refresh`: it imports and registers all
that could be compiled, a quarter of a second, and scipy if it is installed), and then looks whether the kernel is there. But
machine code only needs the addresses of what it calls. So these names are kept beside it, and a kernel is loaded
without the compiler if each of them has an address; if not, the compiler is made ready first, as numba would have done. Only a
kernel that is not on disk needs it in any case, also after others were loaded without.

Two more things are left undone until they are needed: the intermediate code of a kernel is parsed when another is compiled
that calls it, and the environments of what was inlined into it, for which half of numba would be imported, are kept only if
the machine code uses them (it never did).

numba documents none of this. So every name that is used here is looked for first, and what numba's own functions call is
compared with what is known; where anything differs, kernels are cached by numba alone. With RAYGRID_FAST_LOAD=0 they are, too,
from the same files.

A cache looks for its directory when it is first used, not when its function is decorated: nine of ten functions are only
parts of kernels, and are never loaded.

Whichever way a kernel is loaded, its files are sealed and in a place of ours (`node.jit.cache`), and a kernel that
cannot be loaded for whatever reason is as one that is not there: it is compiled, and its files are written anew.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import inspect
import os
import pickle
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numba
from llvmlite import binding as _binding
from numba.core import caching as _caching
from numba.core import codegen as _codegen
from numba.core import config as _config

from raygrid.node.jit import cache
from raygrid.node.jit.cache import (
    DirectoryName,
    doubt,
    in_directory,
    make_private,
    read_sealed,
    say_where,
    write_sealed,
)
from raygrid.node.jit.switches import FAST_LOAD, why_off
from raygrid.node.jit.trusted_files import why_not_trusted
from raygrid.node.remarks import remark

binding: Any = _binding
caching: Any = _caching
codegen: Any = _codegen
config: Any = _config

# The functions of numba that are replaced or relied upon: their parameters, and for some, all names in their code.
_KNOWN: tuple[tuple[str, str, str, set[str] | None], ...] = (
    (
        "Cache",
        "load_overload",
        "self sig target_context",
        {"refresh", "_guard_against_spurious_io_errors", "_load_overload"},
    ),
    ("Cache", "_load_overload", "self sig target_context", None),
    ("CompileResultCacheImpl", "get_filename_base", "self fullname abiflags", None),
    ("CompileResultCacheImpl", "reduce", "self cres", {"_reduce"}),
    ("CompileResultCacheImpl", "rebuild", "self target_context payload", {"compiler", "CompileResult", "_rebuild"}),
)
_UNSERIALIZE = {
    *("create_library", "isinstance", "ll", "parse_bitcode", "_final_module", "_finalize_final_module", "_codegen"),
    *(
        "enable_object_caching",
        "_set_compiled_object",
        "_shared_module",
        "_engine",
        "_load_defined_symbols",
        "ValueError",
    ),
}
_REBUILD = "cls target_context libdata fndesc env signature objectmode lifted typeann reload_init referenced_envs"
_ENVIRONMENT = re.compile(r'@"?(_ZN08NumbaEnv[^"\s,()]*)')


@functools.cache
def can_load_alone() -> bool:
    """Tell whether this numba is one whose kernels can be loaded without its compiler."""
    try:
        for kind, name, parameters, names in _KNOWN:
            function = getattr(getattr(caching, kind), name)
            if _parameters(function) != parameters or (names is not None and set(function.__code__.co_names) != names):
                return False
        own = caching.FunctionCache.load_overload is caching.Cache.load_overload
        result = caching.compiler.CompileResult
        known = _parameters(result._rebuild.__func__) == _REBUILD and hasattr(result, "_replace")
        unserialize = codegen.JITCodeLibrary._unserialize.__func__.__code__
        known = known and set(unserialize.co_names) - {"AssertionError"} == _UNSERIALIZE  # of its assert
        return own and known and not config.NRT_STATS and _have_runtime()
    except (AttributeError, ImportError, TypeError, ValueError):
        return False


def _parameters(function: Any) -> str:
    return " ".join(inspect.signature(function).parameters)


@functools.cache
def _have_runtime() -> bool:
    """Make known to the linker what numba's runtime offers to machine code, as `rtsys.initialize` does."""
    helpers: dict[str, int] = importlib.import_module("numba.core.runtime._nrt_python").c_helpers
    for name, address in helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
    return bool(helpers)


class Names(NamedTuple):
    """Names that a compiled function's machine code wants from outside, and those that it defines."""

    wanted: tuple[str, ...]
    defined: tuple[str, ...]


def names_of(library: Any) -> Names:
    """The names of a library's final module."""
    module = library._get_module_for_linking()
    every = [(one.name, one.is_declaration) for ones in (module.functions, module.global_variables) for one in ones]
    wanted = [name for name, outside in every if outside and not name.startswith("llvm.")]
    return Names(tuple(wanted), tuple(name for name, outside in every if not outside))


def used_environments(library: Any, environments: Sequence[Any]) -> tuple[Any, ...]:
    """Those of a compiled function's environments whose pointers its code uses, not only declares."""
    uses = Counter(_ENVIRONMENT.findall(str(library._final_module)))
    return tuple(one for one in environments if uses[one.env_name] != 1)


_RELIED_UPON = {
    "_SourceFileBackedLocatorMixin": ("from_function", "get_source_stamp", "get_disambiguator"),
    "_CacheLocator": ("get_suitable_cache_subpath",),
    "IndexDataCacheFile": ("save", "_load_index", "_save_index", "_save_data", "_data_path", "_dump"),
    "CompileResultCacheImpl": ("filename_base", "locator"),
    "FunctionCache": ("load_overload", "save_overload", "_index_key"),
    "NullCache": ("load_overload", "save_overload"),
}


@functools.cache
def can_seal() -> bool:
    """Tell whether this numba is one whose files can be sealed; of another nothing is kept."""
    return all(
        hasattr(getattr(caching, kind, None), name) for kind, names in _RELIED_UPON.items() for name in names
    ) and hasattr(caching.CacheImpl, "_locator_classes")


def why_not_alone() -> str | None:
    """Say why kernels are loaded by numba's own means; None if they are loaded without its compiler."""
    if config.NRT_STATS:
        return "NUMBA_NRT_STATS asks for it"
    if not can_seal():
        return f"numba {numba.__version__} keeps kernels in a way that is not known here, so none are kept"
    if not can_load_alone():
        return f"numba {numba.__version__} loads kernels in a way that is not known here"
    return why_off(FAST_LOAD)


_why_not_trusted = functools.cache(why_not_trusted)  # many functions share a directory


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


if can_seal():

    class _Locator(caching._SourceFileBackedLocatorMixin, caching._CacheLocator):  # type: ignore[misc]
        """Locates the files of a function: in the directory in which caches are made now, which may be one to read only."""

        def __init__(self, function: Any, file: str) -> None:
            self._py_file, self._lineno = file, function.__code__.co_firstlineno
            self._path: str = os.path.join(config.CACHE_DIR, self.get_suitable_cache_subpath(file))

        def get_cache_path(self) -> str:
            return self._path

        def ensure_cache_path(self) -> None:
            """Make the directory, as numba's locators do. Raises OSError where nobody should load anything from."""
            make_private(Path(self._path))
            why = _why_not_trusted(self._path)
            if why is not None:
                doubt(self._path, f"the directory is {why}")
                raise OSError(why)

    class _SealedFiles(caching.IndexDataCacheFile):  # type: ignore[misc]
        """Index and data of a function in sealed files. Data say which key they are of: two processes that compile a function
        for other types at the same time may give both the same name, and one index is lost."""

        def load(self, key: Any) -> Any:
            name = self._load_index().get(key)
            sealed = None if name is None else read_sealed(self._data_path(name))
            if sealed is None:
                return None
            kept, data = pickle.loads(sealed)
            return data if kept == key else None

        def save(self, key: Any, data: Any) -> None:
            super().save(key, (key, data))

        def _load_index(self) -> dict[Any, str]:
            sealed = read_sealed(self._index_path)
            if sealed is None:
                return {}
            try:
                version, rest = pickle.loads(sealed)
                stamp, names = pickle.loads(rest) if version == self._version else (None, {})
            except Exception as error:
                doubt(self._index_path, _said(error))
                return {}
            return names if stamp == self._source_stamp else {}

        def _save_index(self, names: dict[Any, str]) -> None:
            write_sealed(self._index_path, pickle.dumps((self._version, self._dump((self._source_stamp, names)))))

        def _save_data(self, name: str, data: Any) -> None:
            write_sealed(self._data_path(name), self._dump(data))

    class _OwnPayload(caching.CompileResultCacheImpl):  # type: ignore[misc]
        """Keeps what numba keeps of a kernel, in our place."""

        _locator_classes = (_Locator,)

    class _Own(caching.FunctionCache):  # type: ignore[misc]
        """numba's cache of a function, in sealed files in our place."""

        _impl_class = _OwnPayload

        def __init__(self, function: Any) -> None:
            super().__init__(function)
            locator = self._impl.locator
            stamp = locator.get_source_stamp()
            self._cache_file = _SealedFiles(locator.get_cache_path(), self._impl.filename_base, stamp)

        def _index_key(self, sig: Any, codegen: Any) -> Any:
            """Without what the function holds, which stands in its name (`node.jit.closures`)."""
            return sig, codegen.magic_tuple(), hashlib.sha256(self._py_func.__code__.co_code).hexdigest()


if can_seal() and can_load_alone():

    class _Payload(_OwnPayload):
        """Keeps of a kernel its names, and what numba keeps; in files that numba alone does not read."""

        def get_filename_base(self, fullname: str, abiflags: str) -> str:
            return f"alone-{super().get_filename_base(fullname, abiflags)}"

        def reduce(self, cres: Any) -> tuple[Names, Any]:
            *kept, environments = super().reduce(cres)
            return names_of(cres.library), (*kept, used_environments(cres.library, environments))

        def rebuild(self, target_context: Any, payload: Any) -> Any:
            names, kept = payload
            if not all(map(binding.address_of_symbol, names.wanted)):
                target_context.refresh()
            (name, kind, data), *rest = kept
            if kind != "object":
                return super().rebuild(target_context, kept)
            lender = _Lender(target_context, _library(target_context.codegen(), name, data, names))
            result = caching.compiler.CompileResult._rebuild(lender, kept[0], *rest)
            return result._replace(target_context=target_context)

    class _PayloadByNumba(_Payload):
        """The same files, loaded as numba loads its own."""

        def rebuild(self, target_context: Any, payload: Any) -> Any:
            return _OwnPayload.rebuild(self, target_context, payload[1])

    class _ByNumba(_Own):
        """numba's cache of a function, over files that can also be loaded without its compiler."""

        _impl_class = _PayloadByNumba

    class _Alone(_Own):
        """numba's cache of a function, that looks first."""

        _impl_class = _Payload

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            with self._guard_against_spurious_io_errors():
                found = self._load_overload(sig, target_context)
                if found is not None:
                    return found
            return super().load_overload(sig, target_context)


def _library(generator: Any, name: str, data: tuple[bytes, bytes], names: Names) -> Any:
    """Make a library of object code as `JITCodeLibrary._unserialize` does, but parse the module for linking if it is asked for."""
    object_code, bitcode = data
    library = generator.create_library(name)

    def module_for_linking() -> Any:
        if library._shared_module is None:
            library._shared_module = binding.parse_bitcode(bitcode)
        return library._shared_module

    library.enable_object_caching()
    library._set_compiled_object(object_code)
    library._get_module_for_linking = module_for_linking
    library._finalize_final_module()
    generator._engine._defined_symbols.update(names.defined)
    return library


class _Lender:
    """Stands for a target context while a result is rebuilt: lends it a library that is made already."""

    def __init__(self, context: Any, library: Any) -> None:
        self.typing_context, self.get_executable = context.typing_context, context.get_executable
        self._library = library

    def codegen(self) -> _Lender:
        return self

    def unserialize_library(self, _state: Any) -> Any:
        return self._library


def _cache_kind() -> Any:
    """The class of caches that this process uses."""
    if not can_load_alone():
        return _Own
    return _Alone if why_off(FAST_LOAD) is None else _ByNumba


class LazyCache:
    """The cache of a function, in a directory as of `node.jit.cache`; what numba asks of a cache, handed on to one."""

    def __init__(self, function: Any, directory: DirectoryName) -> None:
        self._function, self._directory = function, directory

    @functools.cached_property
    def _cache(self) -> Any:
        if self._directory is None or not can_seal():
            return caching.NullCache()
        with in_directory(self._directory):
            try:
                return _cache_kind()(self._function)
            except RuntimeError:  # this function's own directory cannot be used: compiled anew in each process
                return caching.NullCache()

    @property
    def _file(self) -> str:
        return getattr(getattr(self._cache, "_cache_file", None), "_index_path", self.cache_path)

    @property
    def cache_path(self) -> str:
        """Directory of its files; a place where none can be, if there are none."""
        return self._cache.cache_path or os.devnull

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function for these types, None if it is not on disk, or cannot be loaded."""
        try:
            return self._cache.load_overload(sig, target_context)
        except Exception as error:  # whatever is wrong with what was kept, compiling it mends
            doubt(self._file, _said(error))
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function, if that can be; say why if not."""
        say_where()
        if not can_seal():
            why = f"numba {numba.__version__} keeps them in a way that is not known here"
            remark("kept", f"compiled kernels cannot be kept, and each run compiles them anew ({why})")
        if not cache.KEEPING.writable:
            return
        try:
            self._cache.save_overload(sig, data)
        except OSError as error:
            why = f"{error.strerror or error}: {error.filename or self._file}"
            remark("kept", f"compiled kernels cannot be kept, and each run compiles them anew ({why})")

    def enable(self) -> None:
        """Do what numba's caches do."""
        self._cache.enable()

    def disable(self) -> None:
        """Do what numba's caches do."""
        self._cache.disable()

    def flush(self) -> None:
        """Forget what is on disk."""
        self._cache.flush()
