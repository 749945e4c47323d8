"""Modules that are not to be imported for a while."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def hidden(name: str) -> Iterator[None]:
    """Within, a module that nobody has imported so far cannot be; afterwards it can.

    For what a library imports only if it is installed, such as scipy by numba, which looks at its version.
    """
    if name in sys.modules:
        yield
        return
    sys.modules[name] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        sys.modules.pop(name, None)
