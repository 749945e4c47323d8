"""What the kernel says of memory: looked up when it is due, and by every process for itself."""

import os

import pytest

from raygrid.node.runtime import memory_stats


@pytest.fixture
def looked(monkeypatch):
    """The files that were looked at; each look finds one byte more. The clock stands at 100 s."""
    files = []

    def look(path, names):
        files.append(path)
        return len(files)

    monkeypatch.setattr(memory_stats, "_sum_of", look)
    monkeypatch.setattr(memory_stats, "_private", (0, -1.0, 0))
    monkeypatch.setattr(memory_stats.time, "monotonic", lambda: 100.0)
    return files


def test_private_memory_is_looked_up_again_when_it_is_ten_seconds_old(looked, monkeypatch):
    assert [memory_stats.private_memory() for _ in range(3)] == [1, 1, 1]
    monkeypatch.setattr(memory_stats.time, "monotonic", lambda: 109.9)
    assert memory_stats.private_memory() == 1
    monkeypatch.setattr(memory_stats.time, "monotonic", lambda: 110.0)
    assert memory_stats.private_memory() == 2
    assert looked == ["/proc/self/smaps_rollup"] * 2


def test_a_fork_looks_for_itself(looked, monkeypatch):
    memory_stats.private_memory()
    monkeypatch.setattr(memory_stats.os, "getpid", lambda: -5)
    assert memory_stats.private_memory() == 2


def test_it_is_what_the_kernel_says():
    grown = bytearray(os.urandom(8_000_000))
    assert len(grown) < memory_stats.private_memory() <= memory_stats.peak_memory()
