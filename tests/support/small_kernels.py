"""A few small kernels, called in processes of their own that share a cache."""

from __future__ import annotations

import atexit
import functools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

MODULE = """
import numpy as np

from raygrid.node.jit.decorators import kernel, lean, part


@part
def double(x):
    return 2.0 * x


@lean
def total(values):
    sum = 0.0
    for k in range(len(values)):
        sum += double(values[k])
    return sum


@kernel
def doubled(values):
    made = np.empty(len(values))
    for k in range(len(values)):
        if values[k] < 0.0:
            raise ValueError("a value below 0")
        made[k] = double(values[k])
    return made, total(values)


@lean
def third(values):
    return values[2]


@kernel
def later(values):
    return doubled(values)[1] + total(values) + third(values)
"""
# Counts how often the compiler is made ready, and what is compiled.
RUN = """
import json, sys
from numba.core import event
from numba.core.base import BaseContext

ready, compiled = [], []
refresh = BaseContext.refresh
BaseContext.refresh = lambda self: (ready.append(1), refresh(self))[1]


class Compilations(event.Listener):
    def on_start(self, event):
        function = event.data["dispatcher"].py_func
        if function.__module__ == "small":  # and not a part of numba
            compiled.append(function.__name__)

    def on_end(self, event):
        pass


{before}
import numpy as np
import small
values = np.array([1.0, 2.0, 3.0])
with event.install_listener("numba:compile", Compilations()):
    result = [{calls}]
print(json.dumps(dict(result=result, ready=len(ready), compiled=sorted(set(compiled)))))
"""
BOTH = "small.doubled(values)[0].tolist(), small.doubled(values)[1], small.total(values)"
WANTED = [[2.0, 4.0, 6.0], 12.0, 12.0]


class SmallKernels:
    """The small kernels with a cache of their own, in the directory `cache`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.cache = folder / "cache"
        (folder / "small.py").write_text(MODULE)

    def run(self, calls: str = BOTH, before: str = "", **variables: str) -> tuple[dict[str, Any], str]:
        """Call them in a new process: (results, how often the compiler was made ready, what was compiled; standard error)."""
        env = os.environ | {"RAYGRID_CACHE": str(self.cache), "PYTHONPATH": str(self._folder)} | variables
        told = subprocess.run(
            [sys.executable, "-c", RUN.format(calls=calls, before=before)],
            capture_output=True,
            text=True,
            timeout=250,
            env=env,
        )
        assert told.returncode == 0, told.stderr
        return json.loads(told.stdout), told.stderr

    def files(self, suffix: str) -> list[Path]:
        """What is kept."""
        return sorted(self.cache.glob(f"kernels-*/*/*.{suffix}"))

    def keep_compiled(self) -> None:
        """Hold what is compiled of them, as if they had run once here: that is done once and copied."""
        _compiled_once().copy_to(self)

    def copy_to(self, other: SmallKernels) -> None:
        """Let another cache hold what this one does; where files are kept depends on where the module is."""
        shutil.copystat(self._folder / "small.py", other._folder / "small.py")  # numba may look how old a source is
        for directory in self.cache.glob("kernels-*/*"):
            target = other.cache / directory.parent.name / self._place(directory.name, other)
            shutil.copytree(directory, target)

    def _place(self, name: str, other: SmallKernels) -> str:
        """The name of a function's directory, for the same function in another folder."""
        return other._own_name if name == self._own_name else name

    @property
    def _own_name(self) -> str:
        from numba.core.caching import UserProvidedCacheLocator

        return str(UserProvidedCacheLocator.get_suitable_cache_subpath(str(self._folder / "small.py")))


@functools.cache
def _compiled_once() -> SmallKernels:
    folder = Path(tempfile.mkdtemp(prefix="small-kernels-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    small = SmallKernels(folder)
    small.run()
    return small
