"""Reads what the kernel of the operating system says of this process' memory."""

from __future__ import annotations

import contextlib
import ctypes
import os
import time

# age at which private memory is looked up again: that takes the kernel longer than a small frame
PRIVATE_SECONDS = 10.0
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of mallopt(3)
KEPT_MEMORY, LARGEST_KEPT = 1 << 25, 1 << 22  # bytes
_private = (0, -1.0, 0)  # process, when, bytes


def _sum_of(path: str, names: tuple[str, ...]) -> int:
    """Sum of the named lines of a /proc file, given there in kB; 0 if it cannot be read."""
    try:
        with open(path, encoding="ascii") as lines:
            return 1024 * sum(int(line.split()[1]) for line in lines if line.startswith(names))
    except (OSError, ValueError):
        return 0


def peak_memory() -> int:
    """Bytes: the most resident memory of this process, pages that it shares with its launcher included."""
    return _sum_of("/proc/self/status", ("VmHWM:",))


def proportional_memory(pid: int | str = "self") -> int:
    """Bytes resident of a process, of pages that n processes share the n-th part (PSS); 0 if it is gone.

    The only figure that can be added up over the nodes, which share most of what their launcher has read and compiled.
    """
    return _sum_of(f"/proc/{pid}/smaps_rollup", ("Pss:",))


def private_memory() -> int:
    """Bytes resident that no other process shares, as of PRIVATE_SECONDS ago at most."""
    global _private
    pid, now = os.getpid(), time.monotonic()
    if _private[0] != pid or now - _private[1] >= PRIVATE_SECONDS:  # a fork starts anew
        _private = pid, now, _sum_of("/proc/self/smaps_rollup", ("Private_Clean:", "Private_Dirty:"))
    return _private[2]


def keep_freed_memory() -> None:
    """Let glibc keep what is freed for what is allocated next.

    Else each message of more than 128 KiB would get pages of its own from the kernel, cleared by it, and give them back.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_TRIM_THRESHOLD, KEPT_MEMORY)
        mallopt(M_MMAP_THRESHOLD, LARGEST_KEPT)
