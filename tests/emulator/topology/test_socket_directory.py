"""The socket directory, and that a front end leaves neither it nor a process behind, however it ends."""

import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import psutil
import pytest
from support.processes import FrontEnd, Gate, Leftovers, gate, no_leftovers, wait_dead

from raygrid.emulator.topology import socket_directory
from raygrid.emulator.topology.process_stat import process_mark
from raygrid.emulator.topology.socket_directory import (
    PID_FILE,
    SocketDirectory,
    endpoint,
    host_endpoint,
    longest_path,
    sweep,
    why_not_usable,
)
from raygrid.node.errors import ArrayError

pytestmark = pytest.mark.usefixtures("no_leftovers")
__all__ = ["gate", "no_leftovers"]  # fixtures

NOBODY = 65534


@pytest.fixture
def base(no_leftovers, monkeypatch) -> Path:
    """A private directory that is all of the bases."""
    monkeypatch.setattr(socket_directory, "bases", lambda: [no_leftovers])
    return Path(no_leftovers)


@pytest.fixture
def elsewhere(tmp_path_factory, monkeypatch) -> Path:
    """A short temporary directory beside XDG_RUNTIME_DIR, the second choice."""
    with tempfile.TemporaryDirectory(prefix="rgtest-", dir="/tmp") as path:
        monkeypatch.setattr(tempfile, "tempdir", path)
        yield Path(path)


@pytest.fixture
def no_root():
    """The rights of an ordinary user; root may write anywhere."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


def dead_process() -> int:
    """The id of a process that has ended."""
    process = subprocess.Popen(["true"])
    process.wait()
    return process.pid


def make_directory(base: Path, mark: str | None, age: float = 0.0) -> Path:
    """A socket directory as another front end would have left it, last changed `age` seconds ago."""
    path = Path(base, socket_directory._fresh_name())
    path.mkdir(0o700)
    (path / "0-0,0,0x").touch()
    if mark is not None:
        (path / PID_FILE).write_text(mark)
    then = path.stat().st_mtime - age
    os.utime(path, (then, then))
    return path


# --- names ---------------------------------------------------------------------------------------


def test_endpoints():
    assert endpoint("/run/user/1/raygrid-ab", 3, (1, 2, 0), 1) == "ipc:///run/user/1/raygrid-ab/3-1,2,0y"
    assert host_endpoint("/run/user/1/raygrid-ab", 3, (1, 2, 0)) == "ipc:///run/user/1/raygrid-ab/3-1,2,0h"


def test_no_two_links_and_epochs_share_an_endpoint():
    cells = [(x, y, z) for x in range(12) for y in range(12) for z in range(2)]
    names = [endpoint("/d", epoch, cell, axis) for epoch in (0, 1, 11) for cell in cells for axis in range(3)]
    names += [host_endpoint("/d", epoch, cell) for epoch in (0, 1, 11) for cell in cells]
    assert len(set(names)) == len(names) == 3 * len(cells) * 4


def test_no_path_of_the_array_is_longer_than_the_longest():
    shape = (11, 2, 101)
    longest = longest_path("/ö", shape)
    cells = [(x, y, z) for x in range(shape[0]) for y in range(shape[1]) for z in range(shape[2])]
    paths = [endpoint("/ö", 65535, cell, axis)[len("ipc://") :] for cell in cells for axis in range(3)]
    assert max(len(path.encode()) for path in paths) == longest


# --- the directory -------------------------------------------------------------------------------


@pytest.mark.parametrize("umask", [0, 0o777])
def test_only_its_owner_may_enter(base, umask):
    base.chmod(0o755)
    before = os.umask(umask)
    try:
        place = SocketDirectory.create((2, 2, 2))
    finally:
        os.umask(before)
    with place:
        status = os.lstat(place.path)
        assert stat.S_ISDIR(status.st_mode)
        assert stat.S_IMODE(status.st_mode) == 0o700
        assert status.st_uid == os.geteuid()
        assert Path(place.path).parent == base
        assert (Path(place.path) / PID_FILE).read_text().split()[0] == str(os.getpid())
    assert list(base.iterdir()) == []


def test_names_are_fresh(base):
    with SocketDirectory.create((1, 1, 1)) as one, SocketDirectory.create((1, 1, 1)) as two:
        assert one.path != two.path
        assert len(Path(one.path).name) == len("raygrid-") + 12


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_it_is_removed_with_all_that_is_in_it(base, error):
    place = SocketDirectory.create((1, 1, 1))
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(endpoint(place.path, 0, (0, 0, 0), 0).removeprefix("ipc://"))
    with pytest.raises(error), place:
        raise error
    assert list(base.iterdir()) == []
    place.remove()  # once more does no harm


def test_it_is_removed_though_a_socket_is_made_in_it_meanwhile(base, monkeypatch):
    made, rmdir = [], os.rmdir

    def late(path, **options):
        if not made:
            made.append(Path(path, "0-0,0,0h"))
            made[0].touch()
        rmdir(path, **options)

    with SocketDirectory.create((2, 2, 2)) as place:
        monkeypatch.setattr(os, "rmdir", late)
    assert made
    assert not os.path.lexists(place.path)


def test_a_fork_does_not_remove_it(base):
    with SocketDirectory.create((1, 1, 1)) as place:
        fork = os.fork()
        if fork == 0:
            place.remove()
            os._exit(0)
        os.waitpid(fork, 0)
        assert Path(place.path).exists()


def test_the_longest_socket_of_the_largest_array_can_be_bound(base):
    shape = (65535, 65535, 65535)
    with SocketDirectory.create(shape) as place, socket.socket(socket.AF_UNIX) as bound:
        path = endpoint(place.path, 65535, (65534, 65534, 65534), 2).removeprefix("ipc://")
        assert len(path) == longest_path(place.path, shape)
        bound.bind(path)


# --- where it is made ----------------------------------------------------------------------------


def refusals(monkeypatch) -> str:
    """What creating says when the only base is the directory XDG_RUNTIME_DIR."""
    monkeypatch.setattr(socket_directory, "bases", lambda: [os.environ["XDG_RUNTIME_DIR"]])
    with pytest.raises(ArrayError, match="wanted one that is ours or sticky, can be written, and is short") as error:
        SocketDirectory.create((2, 2, 2))
    return str(error.value)


def test_the_runtime_directory_comes_first(no_leftovers, elsewhere):
    with SocketDirectory.create((2, 2, 2)) as place:
        assert os.path.dirname(place.path) == no_leftovers


@pytest.mark.parametrize("value", ["", "/no/such/directory", "not/absolute", "/etc/passwd", "/" + "long/" * 30])
def test_without_a_usable_one_the_temporary_directory_is_taken(monkeypatch, elsewhere, value):
    monkeypatch.setenv("XDG_RUNTIME_DIR", value)
    with SocketDirectory.create((2, 2, 2)) as place:
        assert os.path.dirname(place.path) == str(elsewhere)


def test_with_a_long_temporary_directory_too_tmp_is_taken(monkeypatch, tmp_path):
    long = tmp_path / ("l" * 80)
    long.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(long))
    monkeypatch.setattr(tempfile, "tempdir", str(long))
    with SocketDirectory.create((2, 2, 2)) as place:
        assert os.path.dirname(place.path) == os.path.realpath("/tmp")


def no_temporary_directory() -> str:
    raise FileNotFoundError(2, "No usable temporary directory found")


def test_without_any_temporary_directory_the_runtime_directory_will_do(monkeypatch, no_leftovers):
    monkeypatch.setattr(tempfile, "gettempdir", no_temporary_directory)
    with SocketDirectory.create((2, 2, 2)) as place:
        assert os.path.dirname(place.path) == no_leftovers


def test_without_any_directory_at_all_one_sentence_says_so(monkeypatch):
    monkeypatch.setattr(tempfile, "gettempdir", no_temporary_directory)
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/nowhere")
    monkeypatch.setattr(socket_directory, "_unsafe", lambda _base, _status: "not writable")
    with pytest.raises(ArrayError) as error:
        SocketDirectory.create((2, 2, 2))
    assert str(error.value) == (
        f"no directory for the sockets of the array: /nowhere (No such file or directory), {os.path.realpath('/tmp')} "
        "(not writable); wanted one that is ours or sticky, can be written, and is short: set XDG_RUNTIME_DIR or TMPDIR"
    )


def test_a_long_path_is_told_with_its_length(monkeypatch, tmp_path):
    long = tmp_path / ("l" * 100)
    long.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(long))
    length = len(f"{long}/raygrid-0123456789ab/65535-1,1,1x")
    assert f"its socket paths would have {length} bytes, at most 107 are allowed" in refusals(monkeypatch)


def test_what_keeps_an_array_from_a_directory_is_told_of_each_without_making_any(monkeypatch, elsewhere):
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/tmp/raygrid-tests/none")  # short: a path may be too long as well
    before = set(os.listdir(elsewhere))
    found = why_not_usable((2, 2, 2))
    assert list(found.items())[:2] == [("/tmp/raygrid-tests/none", "No such file or directory"), (str(elsewhere), None)]
    assert set(os.listdir(elsewhere)) == before


def test_a_symbolic_link_in_the_way(monkeypatch, base):
    (base / "real").mkdir()
    (base / "link").symlink_to(base / "real")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base / "link"))
    assert f"{base}/link (a symbolic link)" in refusals(monkeypatch)


def test_a_link_with_the_name_of_the_directory_is_not_followed(monkeypatch, base, tmp_path):
    monkeypatch.setattr(socket_directory, "_fresh_name", lambda: "raygrid-known")
    (base / "raygrid-known").symlink_to(tmp_path)
    assert "(File exists)" in refusals(monkeypatch)
    assert list(tmp_path.iterdir()) == []
    (base / "raygrid-known").unlink()


@pytest.mark.parametrize(
    ("mode", "safe"), [(0o700, True), (0o755, True), (0o777, False), (0o770, False), (0o1777, True)]
)
def test_others_must_not_be_able_to_exchange_it(monkeypatch, base, mode, safe):
    base.chmod(mode)
    if safe:
        SocketDirectory.create((1, 1, 1)).remove()
    else:
        assert f"{base} (writable by others and not sticky)" in refusals(monkeypatch)
    base.chmod(0o700)


def test_one_that_cannot_be_written(monkeypatch, base, no_root):
    # Owned by root, or by us without the right to write.
    if os.stat(base).st_uid == os.geteuid():
        base.chmod(0o500)
    else:
        os.seteuid(0)
        base.chmod(0o755)
        os.seteuid(NOBODY)
    assert f"{base} (not writable)" in refusals(monkeypatch)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a directory away")
def test_one_of_another_user(monkeypatch, base):
    os.chown(base, NOBODY, NOBODY)
    assert f"{base} (owned by user {NOBODY})" in refusals(monkeypatch)
    os.chown(base, 0, 0)


# --- what dead front ends left -------------------------------------------------------------------


def test_the_directory_of_a_dead_front_end_is_swept(base):
    pid = dead_process()
    stale = make_directory(base, f"{pid} 1 {os.readlink('/proc/self/ns/pid')}\n")
    with SocketDirectory.create((1, 1, 1)):
        assert not stale.exists()


def test_a_process_id_that_was_used_again_does_not_save_it(base):
    pid, started, namespace = process_mark(os.getppid()).split()
    stale = make_directory(base, f"{pid} {int(started) - 1} {namespace}\n")
    assert sweep(str(base)) == [str(stale)]


@pytest.mark.parametrize(
    ("mark", "age"),
    [
        (process_mark(os.getppid()), 1000.0),  # of a living process
        ("999999999 1 pid:[1]", 1000.0),  # of another namespace, whose processes we cannot see
        (None, 1.0),  # just being made
        ("12", 1.0),  # just being written
    ],
)
def test_what_may_be_alive_is_left(base, mark, age):
    path = make_directory(base, mark, age)
    assert sweep(str(base)) == []
    assert path.exists()
    socket_directory.remove(str(path))


@pytest.mark.parametrize("mark", [None, "", "rubbish", "ö"])
def test_what_was_never_signed_is_swept_after_a_while(base, mark):
    path = make_directory(base, mark, age=61.0)
    assert sweep(str(base)) == [str(path)]


def test_only_directories_of_ours_are_swept(base, tmp_path):
    (tmp_path / "precious").touch()
    link, file, other = base / "raygrid-0123456789ab", base / "raygrid-ba9876543210", base / "other"
    link.symlink_to(tmp_path)
    file.touch()
    other.mkdir()
    assert sweep(str(base)) == []
    socket_directory.remove(str(link))
    socket_directory.remove(str(other))
    assert (tmp_path / "precious").exists()
    assert len(list(base.iterdir())) == 3
    link.unlink()
    file.unlink()


@pytest.mark.parametrize(
    "name", ["raygrid-pictures", "raygrid-0123456789", "raygrid-0123456789abc", "raygrid-0123456789AB"]
)
def test_a_directory_that_a_user_named_after_raygrid_is_never_removed(base, name):
    path = base / name
    path.mkdir()
    (path / "picture.png").touch()
    os.utime(path, (0.0, 0.0))
    assert sweep(str(base)) == []
    socket_directory.remove(str(path))
    assert (path / "picture.png").exists()
    shutil.rmtree(path)


def test_sweeping_what_is_not_there_does_nothing(tmp_path):
    assert sweep(str(tmp_path / "none")) == []


def test_a_front_end_killed_together_with_its_fork_server_is_swept_after(gate: Gate):
    front_end = FrontEnd(gate.path, "waits")
    gate.wait_for(3)
    os.kill(front_end.fork_server, signal.SIGSTOP)  # it must not clean up in its place
    front_end.process.kill()
    os.kill(front_end.fork_server, signal.SIGKILL)
    gate.wait_empty()
    front_end.finish()
    assert Path(front_end.directory).exists()
    with SocketDirectory.create((1, 1, 1)):
        assert not Path(front_end.directory).exists()


# --- the end of the front end --------------------------------------------------------------------


@pytest.mark.parametrize("how", ["waits", "polls"])
def test_a_killed_front_end_leaves_neither_process_nor_directory(gate: Gate, how):
    front_end = FrontEnd(gate.path, how)
    gate.wait_for(3)
    assert Path(front_end.directory).exists()
    front_end.process.kill()
    gate.wait_empty()
    wait_dead(front_end.fork_server)
    front_end.finish()
    assert not Path(front_end.directory).exists()


def test_a_front_end_killed_while_the_fork_server_compiles_leaves_nothing(gate: Gate):
    front_end = FrontEnd(gate.path, "waits", warm="warm_for_ever")
    assert front_end.process.stdout.readline() == "stuck\n"
    front_end.process.kill()
    wait_dead(front_end.fork_server)
    front_end.finish()
    assert not Path(front_end.directory).exists()


def test_a_fork_that_keeps_the_socket_open_does_not_keep_the_nodes(gate: Gate):
    front_end = FrontEnd(gate.path, "has a fork")
    gate.wait_for(3)
    forks = [child for child in psutil.Process(front_end.process.pid).children() if child.pid != front_end.fork_server]
    while not forks:
        forks = [
            child for child in psutil.Process(front_end.process.pid).children() if child.pid != front_end.fork_server
        ]
    front_end.process.kill()
    gate.wait_empty()
    wait_dead(front_end.fork_server)
    for fork in forks:
        fork.kill()
    front_end.finish()


@pytest.mark.parametrize("how", ["waits", "polls"])
def test_ctrl_c_leaves_nothing(gate: Gate, how):
    front_end = FrontEnd(gate.path, how)
    gate.wait_for(3)
    os.killpg(front_end.process.pid, signal.SIGINT)  # what the terminal does
    assert "KeyboardInterrupt" in front_end.finish()
    assert not psutil.pid_exists(front_end.fork_server)
    assert not Path(front_end.directory).exists()
    gate.wait_empty()


@pytest.mark.parametrize("how", ["forgets", "ends", "ignores children"])
def test_a_front_end_that_simply_ends_leaves_nothing(gate: Gate, how):
    front_end = FrontEnd(gate.path, how)
    assert front_end.finish() == ""
    assert front_end.process.returncode == 0
    assert not psutil.pid_exists(front_end.fork_server)
    assert not Path(front_end.directory).exists()


# --- the check that nothing is left behind -------------------------------------------------------


def test_the_check_sees_what_is_left(no_leftovers):
    leftovers = Leftovers(os.environ["RAYGRID_TEST_MARK"], no_leftovers, grace=0.05)
    sleeper = [sys.executable, "-c", "import signal; signal.pause()"]
    child = subprocess.Popen(sleeper, env={})
    # An orphan in a session of its own: only its environment tells whose it is.
    script = f"import subprocess; print(subprocess.Popen({sleeper!r}, start_new_session=True, stdout=-3).pid)"
    orphan = int(subprocess.check_output([sys.executable, "-c", script]))
    reading, writing = os.pipe()
    place = SocketDirectory.create((1, 1, 1))
    with socket.socket() as left:
        found = "\n".join(leftovers.find())
        assert f"process {child.pid} (" in found
        assert f"process {orphan} (" in found
        assert f"directory {place.path}" in found
        assert f"descriptor {left.fileno()} socket:" in found
        assert f"descriptor {reading} pipe:" in found
    os.close(reading)
    os.close(writing)
    child.wait()
    place.remove()
    assert leftovers.find() == []
