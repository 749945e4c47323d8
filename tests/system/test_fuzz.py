"""The fuzz of a running array (`benchmarks/fuzz.py`), a small part of it."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from support import paths
from support.processes import no_leftovers

FUZZ = paths.ROOT / "benchmarks" / "fuzz.py"
__all__ = ["no_leftovers"]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("no_leftovers")
@pytest.mark.parametrize("seed", [2, 3])
def test_malformed_packets_and_messages_end_no_process_and_change_no_picture(seed):
    command = [sys.executable, str(FUZZ), "--messages", "20000", "--epochs", "8", "--seed", str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=250, env=os.environ)
    assert done.stdout.endswith("processes lost: none; picture afterwards: right\n"), done.stdout + done.stderr
    assert done.returncode == 0
