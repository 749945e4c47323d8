"""What is kept of compiled kernels is believed only if it is whole and ours; whatever else is there is compiled anew."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.paths import ROOT
from support.small_kernels import WANTED, SmallKernels

from raygrid.node import remarks
from raygrid.node.jit import cache
from raygrid.node.jit.cache import SEALED, read_sealed, write_sealed
from raygrid.node.jit.trusted_files import why_not_trusted

pytestmark = pytest.mark.usefixtures("fast_paths_on")

OURS = ["double", "doubled", "total"]
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")


@pytest.fixture
def small(tmp_path):
    return SmallKernels(tmp_path)


@pytest.fixture
def heard():
    """What is remarked, also of what was remarked before."""
    told, said = [], set(remarks._told)
    remarks._told.clear()
    with remarks.heard_by(told.append):
        yield told
    remarks._told.clear()
    remarks._told.update(said)


# --- whole kernels ---------------------------------------------------------------------------------------


def flipped(data):
    return data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]


DAMAGES = {
    "a flipped bit": flipped,
    "cut": lambda data: data[:-1],
    "empty": lambda data: b"",
    "zeroed": lambda data: bytes(len(data)),
}


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_kernels_are_compiled_anew_and_that_is_said_once(small, damage, suffix, kept):
    kept(small)
    before = small.files(suffix)
    assert len(before) == 3
    for path in before:
        path.write_bytes(DAMAGES[damage](path.read_bytes()))
    again, told = small.run()
    assert again["result"] == WANTED
    assert {"doubled", "total"} <= set(again["compiled"])
    assert told.count("note: ") == 1
    assert any(f"{path}: compiled code that cannot be used (" in told for path in before)
    assert small.run() == ({"result": WANTED, "ready": 0, "compiled": []}, "")


@pytest.fixture
def kept():
    """Lets small kernels in another folder have what was compiled once."""
    return lambda small: small.keep_compiled()


def test_a_sealed_file_that_cannot_be_loaded_is_compiled_anew(small, kept):
    kept(small)
    for path in small.files("nbc"):
        write_sealed(str(path), pickle.dumps(os.getcwd)[:-1] + b"x.")
    again, told = small.run()
    assert (again["result"], told.count("cannot be used")) == (WANTED, 1)
    assert small.run() == ({"result": WANTED, "ready": 0, "compiled": []}, "")


def test_a_kernel_of_another_key_is_not_taken(small, kept):
    """As when two processes compiled for other types at once, and one index was lost."""
    kept(small)
    total, doubled = (next(path for path in small.files("nbc") if name in path.name) for name in ("total-", "doubled-"))
    total.write_bytes(doubled.read_bytes())
    again, _ = small.run()
    assert (again["result"], again["compiled"]) == (WANTED, ["total"])


def test_by_numba_alone_damage_is_found_too(small):
    other = "from numba.core import compiler\nmake = compiler.CompileResult._rebuild\n"
    other += "compiler.CompileResult._rebuild = classmethod(lambda cls, *all: make(*all))"
    small.run(before=other)
    for path in small.files("nbc"):
        path.write_bytes(flipped(path.read_bytes()))
    again, told = small.run(before=other)
    assert (again["result"], told.count("cannot be used")) == (WANTED, 1)
    assert small.run(before=other)[0]["compiled"] == []


def test_a_cache_that_can_be_read_and_not_written_is_used(small, kept):
    kept(small)
    read_only = "import os\nos.access = lambda *_, **__: False"
    assert small.run(before=read_only) == ({"result": WANTED, "ready": 0, "compiled": []}, "")
    before = small.files("*")
    again, told = small.run("small.later(values)", read_only)
    assert (again["result"], again["compiled"]) == ([27.0], ["later", "third"])
    assert f"{small.cache}" in told
    assert "cannot be written" in told
    assert "set RAYGRID_CACHE" in told
    assert small.files("*") == before


def test_a_full_disk_is_told_of_and_everything_goes_on(small):
    full = "from raygrid.node.jit import fast_load\ndef write(path, data): raise OSError(28, 'No space left on device', path)\n"
    again, told = small.run(before=full + "fast_load.write_sealed = write")
    assert (again["result"], again["compiled"]) == (WANTED, OURS)
    assert told.count("note: compiled kernels cannot be kept") == 1
    assert f"No space left on device: {small.cache}" in told


@as_root
def test_pickles_of_another_user_are_not_run(small, kept, tmp_path):
    """A directory of the right name that somebody else made, with what runs as whoever loads it."""
    kept(small)
    mark = tmp_path / "was run"
    directory = next(small.cache.iterdir())
    for path in small.files("nbc"):
        write_sealed(str(path), b"cos\nsystem\n(S'touch \"" + os.fsencode(mark) + b"\"'\ntR.")
    os.chown(directory, 12345, -1)
    again, told = small.run()
    assert again["result"] == WANTED
    assert not mark.exists()
    assert "owned by user 12345" in told or not again["compiled"]  # kept beside the sources before


# --- sealed files ----------------------------------------------------------------------------------------


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.binary(max_size=200), st.data())
def test_a_sealed_file_is_read_whole_or_not_at_all(tmp_path, heard, data, chance):
    path = str(tmp_path / "file")
    write_sealed(path, data)
    assert read_sealed(path) == data
    assert os.listdir(tmp_path) == ["file"]
    whole = Path(path).read_bytes()
    assert len(whole) == SEALED + len(data)
    other = chance.draw(
        st.one_of(
            st.integers(0, len(whole) - 1).map(lambda end: whole[:end]),
            st.integers(0, 8 * len(whole) - 1).map(lambda bit: _with_bit_flipped(whole, bit)),
            st.binary(min_size=1, max_size=9).map(lambda more: whole + more),
        )
    )
    Path(path).write_bytes(other)
    assert read_sealed(path) is None


def _with_bit_flipped(data, bit):
    return data[: bit // 8] + bytes([data[bit // 8] ^ 1 << bit % 8]) + data[bit // 8 + 1 :]


def test_what_is_no_plain_file_of_ours_is_not_read(tmp_path, heard):
    real, link, pipe = (str(tmp_path / name) for name in ("real", "link", "pipe"))
    write_sealed(real, b"kernel")
    os.symlink(real, link)
    os.mkfifo(pipe)
    assert read_sealed(link) is read_sealed(pipe) is read_sealed(str(tmp_path)) is None
    assert read_sealed(str(tmp_path / "none")) is None
    os.chmod(real, 0o666)
    assert read_sealed(real) is None
    assert len(heard) == 1  # about the first, and not about what is not there


@as_root
def test_a_file_of_another_user_is_not_read(tmp_path, heard):
    path = tmp_path / "file"
    write_sealed(str(path), b"kernel")
    os.chown(path, 12345, -1)
    assert read_sealed(str(path)) is None
    assert "owned by user 12345" in heard[0]


# --- places ----------------------------------------------------------------------------------------------


def test_directories_of_which_anybody_else_could_change_something_are_not_trusted(tmp_path):
    place = tmp_path / "above" / "kernels"
    place.mkdir(parents=True, mode=0o700)
    assert why_not_trusted(str(place)) is None
    place.chmod(0o777)
    assert why_not_trusted(str(place)) == "writable by all"
    place.chmod(0o1777)  # sticky: all could still lay files into it
    assert why_not_trusted(str(place)) == "writable by all"
    place.chmod(0o700)
    place.parent.chmod(0o777)
    assert why_not_trusted(str(place)) == f"{place.parent} above it is writable by all"
    place.parent.chmod(0o1777)  # none but we can put another in its place
    assert why_not_trusted(str(place)) is None
    os.symlink(place, tmp_path / "link")
    assert why_not_trusted(str(tmp_path / "link")) == "a symbolic link"
    os.symlink(place.parent, tmp_path / "way")
    assert why_not_trusted(str(tmp_path / "way" / "kernels")) is None  # looked at where it leads
    assert why_not_trusted(str(tmp_path / "none")) == "No such file or directory"


@as_root
def test_directories_of_other_users_are_not_trusted(tmp_path):
    place = tmp_path / "above" / "kernels"
    place.mkdir(parents=True)
    os.chown(place.parent, 12345, -1)
    assert why_not_trusted(str(place)) == f"{place.parent} above it is owned by user 12345"


def test_the_directory_is_private_whatever_the_umask(tmp_path, monkeypatch):
    monkeypatch.setenv("RAYGRID_CACHE", str(tmp_path / "new" / "cache"))
    before = os.umask(0)
    try:
        keeping = cache._keeping()
    finally:
        os.umask(before)
    assert keeping.writable
    assert keeping.why == ""
    for made in (Path(keeping.directory), tmp_path / "new" / "cache", tmp_path / "new"):
        assert made.stat().st_mode & 0o777 == 0o700


def test_a_place_that_is_not_trusted_is_passed_over_and_that_can_be_told(tmp_path, monkeypatch):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    monkeypatch.setenv("RAYGRID_CACHE", str(shared))
    keeping = cache._keeping()
    assert f"{shared} above it is writable by all" in keeping.why
    assert keeping.directory is None or not keeping.directory.startswith(str(shared))


def test_only_old_directories_of_our_own_names_are_forgotten(tmp_path):
    kept = tmp_path / f"kernels-{'0' * 16}"
    others = [f"kernels-{'a' * 16}", f"kernels-{'b' * 16}"]
    theirs = ["kernels-of-mine", f"kernels-{'A' * 16}", f"kernels-{'c' * 17}", "linux-kernels-5"]
    for name in (kept.name, *others, *theirs):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (0, 0))
    os.utime(tmp_path / others[1], (time.time(), time.time()))
    (tmp_path / f"kernels-{'d' * 16}").symlink_to(tmp_path / theirs[0])
    (tmp_path / f"kernels-{'e' * 16}").write_text("a file")
    cache._forget(tmp_path, kept)
    left = {kept.name, others[1], *theirs, f"kernels-{'d' * 16}", f"kernels-{'e' * 16}"}
    assert set(os.listdir(tmp_path)) == left


# --- a directory a state of the sources --------------------------------------------------------------------

NODE_FILES = sorted(str(path.relative_to(ROOT / "node")) for path in (ROOT / "node").rglob("*.py"))
PART = "from raygrid.node.jit.decorators import part\n\n\n@part\ndef scaled(x):\n    return {factor} * x\n"
KERNEL = """
from raygrid.node.geometry.planted import scaled
from raygrid.node.jit.decorators import lean


@lean
def total(x):
    return scaled(x) + 1.0
"""
RUN_COPY = """
import os
import raygrid.node
from raygrid.node.jit import cache
from raygrid.node.tracing.planted import total

assert raygrid.node.__file__.startswith(os.environ["PYTHONPATH"]), raygrid.node.__file__
print(total(5.0), sum(total.stats.cache_misses.values()), cache.DIRECTORY)
"""


@pytest.fixture
def node_copy(tmp_path):
    """A copy of the package of the node; without what is compiled of it."""
    copied = tmp_path / "raygrid" / "node"
    shutil.copytree(ROOT / "node", copied, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "raygrid" / "__init__.py").touch()
    return copied


def test_every_module_of_every_package_is_in_the_digest(node_copy, monkeypatch):
    monkeypatch.setattr(cache, "_SOURCES", node_copy)
    before = cache.digest()
    assert {name.partition("/")[0] for name in NODE_FILES} >= {
        "geometry",
        "jit",
        "protocol",
        "tracing",
        "runtime",
        "timed",
    }
    for name in NODE_FILES:
        path = node_copy / name
        text = path.read_bytes()
        path.write_bytes(text + b"#")
        assert cache.digest() != before, f"a change of node/{name} leaves old machine code in use"
        path.write_bytes(text)
    assert cache.digest() == before
    (node_copy / "tracing" / "step.py").rename(node_copy / "geometry" / "step.py")
    assert cache.digest() != before  # a module that has moved, too


def test_no_old_machine_code_runs_after_a_change_in_another_package(node_copy):
    """The kernel's own file stays as it is: numba by itself would load what it compiled before."""
    root = node_copy.parent.parent
    environment = os.environ | {"PYTHONPATH": str(root), "RAYGRID_CACHE": str(root / "cache")}

    def run(factor):
        (node_copy / "geometry" / "planted.py").write_text(PART.format(factor=factor))
        done = subprocess.run(
            [sys.executable, "-c", RUN_COPY], capture_output=True, text=True, env=environment, cwd=root, timeout=250
        )
        assert done.returncode == 0, done.stderr
        result, compiled, directory = done.stdout.split()
        return float(result), int(compiled), directory

    (node_copy / "tracing" / "planted.py").write_text(KERNEL)
    (first, first_compiled, old), (second, second_compiled, new) = run("2.0"), run("3.0")
    assert (first, second) == (11.0, 16.0)
    assert (first_compiled, second_compiled) == (1, 1)
    assert Path(old).parent == Path(new).parent == root / "cache"
    assert old != new
    assert run("2.0") == (11.0, 0, old)  # and what belongs to these sources is taken, not compiled
