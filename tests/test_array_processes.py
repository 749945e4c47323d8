"""The array of real processes: neighbours only, conservation, what happens when one is lost, and nothing left behind."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from raygrid.emulator.array import Array
from raygrid.emulator.driver import BUDGET
from raygrid.emulator.topology import indices, neighbour_links
from raygrid.host.job import Settings, make_job
from raygrid.host.load import load_scene
from raygrid.host.render import render_job
from raygrid.node.errors import ArrayError, LostProcess, Stuck
from raygrid.node.flood import corners

SCENES = Path(__file__).parents[1] / "scenes"
pytestmark = pytest.mark.usefixtures("no_leftovers")


def job(shape, name="kinds.nff", size=(64, 48), **settings):
    return make_job(load_scene(SCENES / name), shape, Settings(size=size, **settings))


def unix_inodes_of(directory: str) -> dict[int, str]:
    """Inode -> name of each bound unix socket in a directory."""
    found = {}
    for line in Path("/proc/net/unix").read_text().splitlines()[1:]:
        fields = line.split()
        if len(fields) == 8 and fields[7].startswith(directory):
            found[int(fields[6])] = Path(fields[7]).name
    return found


def descriptors(pid: int) -> list[str]:
    """What each open descriptor of a process is, its standard ones (where its last words go) left out."""
    directory = Path(f"/proc/{pid}/fd")
    return [os.readlink(entry) for entry in directory.iterdir() if int(entry.name) > 2]


def test_neighbours_only():
    """A node listens on its own links only, has as many connections as links, and nothing else that leads out."""
    shape = (3, 2, 1)
    with Array.launch(shape) as array:
        render_job(array.driver, job(shape))
        assert array._place is not None
        names = unix_inodes_of(array._place.path)
        wires = list(neighbour_links(shape))
        for pid, index in zip(array.pids, indices(shape), strict=True):
            links = sum(index in (wire.lower, wire.upper) for wire in wires) + (index in corners(shape).values())
            listens = {f"0-{index[0]},{index[1]},{index[2]}{'xyz'[w.axis]}" for w in wires if w.lower == index}
            open_now = descriptors(pid)
            sockets = [int(name[8:-1]) for name in open_now if name.startswith("socket:")]
            # the binding end of a link is a listener and, like each connection that it took, bears the link's name
            assert {names[inode] for inode in sockets if inode in names} == listens
            assert len(sockets) == links + len(listens)
            others = [name for name in open_now if not name.startswith(("socket:", "pipe:", "anon_inode:"))]
            assert not others


def test_no_file_of_the_scene_or_of_shared_memory_is_mapped():
    with Array.launch((2, 1, 1)) as array:
        render_job(array.driver, job((2, 1, 1)))
        for pid in array.pids:
            maps = Path(f"/proc/{pid}/maps").read_text()
            assert "/dev/shm" not in maps
            assert "scenes" not in maps
            writable_and_shared = [line for line in maps.splitlines() if line.split()[1][1::2] == "ws"]
            assert not writable_and_shared


def test_conservation_and_budget():
    shape = (2, 2, 2)
    with Array.launch(shape) as array:
        first = render_job(array.driver, job(shape))
        for budget in (BUDGET, 2000, 1):
            stats = render_job(array.driver, job(shape), budget).stats
            assert stats["total"]["born"] == stats["total"]["died"] == first.stats["total"]["born"]
            assert stats["total"]["born"]["primary"] == 64 * 48
            for node in stats["nodes"]:
                assert node["waiting"] == 0
            # a primary gives rise to at most 2^4 rays of depth 5 at once, each with a shadow ray to both lights
            assert stats["most_in_flight"] <= budget + 8 * 16 * 3 * max(budget // 8, 1)


def test_a_killed_node_is_named_at_once():
    with Array.launch((2, 2, 1)) as array:
        os.kill(array.pids[2], signal.SIGKILL)
        with pytest.raises(LostProcess, match=rf"node 0,1,0 \(pid {array.pids[2]}\) ended: .*"):
            render_job(array.driver, job((2, 2, 1)))
        with pytest.raises(LostProcess, match="node 0,1,0"):
            array.driver.report()


def test_a_node_killed_while_tracing():
    with Array.launch((2, 1, 1)) as array:

        def kill(phase, progress):
            if phase == "trace" and progress is not None and progress.primaries > 0:
                os.kill(array.pids[1], signal.SIGKILL)

        with pytest.raises(LostProcess, match="node 1,0,0"):
            render_job(array.driver, job((2, 1, 1), size=(600, 600)), 1000, kill)


def test_a_stopped_node_is_a_hang():
    with Array.launch((2, 1, 1), patience=1.0) as array:
        os.kill(array.pids[1], signal.SIGSTOP)
        with pytest.raises(Stuck, match="nothing came from the array for 1 seconds"):
            render_job(array.driver, job((2, 1, 1)))


def test_an_exception_in_the_block_ends_the_array():
    with pytest.raises(ZeroDivisionError), Array.launch((2, 1, 1)) as array:
        pids = array.pids
        raise ZeroDivisionError
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_closing_twice_and_use_after_closing():
    array = Array.launch((1, 1, 1))
    array.close()
    array.close()
    with pytest.raises(ArrayError, match="not ready"):
        _ = array.driver


@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 1, 1), (1, 4, 2)])
def test_square_arrays_and_rows(shape):
    with Array.launch(shape) as array:
        stats = render_job(array.driver, job(shape, size=(32, 24))).stats
        assert [tuple(node["index"]) for node in stats["nodes"]] == list(indices(shape))
        assert sum(sum(node["surfaces"].values()) for node in stats["nodes"]) >= stats["surfaces"]


@pytest.mark.slow
def test_forty_processors():
    with Array.launch((5, 4, 2)) as array:
        stats = render_job(array.driver, job((5, 4, 2))).stats
        assert len({node["pid"] for node in stats["nodes"]}) == 40
