"""What the kernel says of this process' memory."""

from __future__ import annotations


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


def private_memory() -> int:
    """Bytes resident now that no other process shares."""
    return _sum_of("/proc/self/smaps_rollup", ("Private_Clean:", "Private_Dirty:"))
