"""The memory that a piece of work takes at most, measured in a process of its own."""

from __future__ import annotations

import subprocess
import sys

from support import paths

MEASURED = """
import sys
from pathlib import Path

sys.path.insert(0, sys.argv[1])


def peak():
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("VmHWM:"))) * 1024


{prepare}
Path("/proc/self/clear_refs").write_text("5")
before = peak()
{work}
print(peak() - before)
"""


def memory_taken(prepare: str, work: str) -> int:
    """Bytes by which the peak of a process rises while it works; two pieces of Python, the first of which comes before.

    In a process of its own: one that has freed memory before takes that again, and its peak hardly rises.
    """
    command = [sys.executable, "-c", MEASURED.format(prepare=prepare, work=work), str(paths.ROOT / "tests")]
    run = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert run.returncode == 0, run.stderr
    return int(run.stdout.split()[-1])
