"""Each fact that `raygrid doctor` tells, with the fact faked; nothing is made or touched by looking."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest
from support.paths import ROOT

from raygrid.emulator.topology import UNLIMITED, Bound, Resources
from raygrid.host.cli import doctor_facts
from raygrid.host.image.ffmpeg import SHIPS
from raygrid.node.jit import cache, fast_load, trusted_files
from raygrid.node.links import zmq_c_api

pytestmark = pytest.mark.usefixtures("fast_paths_on")

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PLENTY = Resources(*(Bound(UNLIMITED, "no limit") for _ in range(4)))


def bare(requirement: str) -> str:
    """The name in a requirement, as pip compares names."""
    return re.split(r"[<>=]", requirement)[0].lower().replace("_", "-")


# --- versions ----------------------------------------------------------------------------------------


def test_every_declared_library_is_told_with_its_version():
    assert {bare(name) for name in doctor_facts.NEEDED} == {bare(one) for one in PROJECT["dependencies"]}
    versions = doctor_facts.read_versions()
    assert versions["numba"] == metadata.version("numba")
    assert set(versions) == {"raygrid", "Python", "libzmq", *doctor_facts.NEEDED}
    assert None not in versions.values()


def test_every_extra_is_told():
    declared = PROJECT["optional-dependencies"]
    assert {name: {bare(one) for one in declared[name]} for name in set(declared) - {"test", "dev", "docs"}} == {
        extra: {bare(name) for name in names} for extra, names in doctor_facts.EXTRAS.items()
    }


def test_a_library_that_is_not_installed_has_no_version(monkeypatch):
    monkeypatch.setattr(doctor_facts, "NEEDED", ("numpy", "no-such-library"))
    assert doctor_facts.read_versions()["no-such-library"] is None


@pytest.mark.parametrize(
    ("version", "bounds", "fits"),
    [
        ("0.62.0", ">=0.62,<0.69", True),
        ("0.68.1", ">=0.62,<0.69", True),
        ("0.69.0", ">=0.62,<0.69", False),
        ("0.69.0rc1", ">=0.62,<0.69", False),
        ("0.7", ">=0.62", False),
        ("10.3", ">=9.10", True),
        ("26.0.0", ">=26.0", True),
        ("1.1.post2", ">=1.1,<2", True),
    ],
)
def test_whether_a_version_was_tried(version, bounds, fits):
    assert doctor_facts._fits(version, bounds) == fits


def test_libraries_that_were_not_tried_are_told_with_what_was(monkeypatch):
    assert doctor_facts.read_misfits() == {}
    wanted = ["numba<0.69,>=0.62", "click>=8.1.7", "no-such>=3", 'pytest>=99; extra == "test"']
    monkeypatch.setattr(doctor_facts.metadata, "requires", lambda _: wanted)
    monkeypatch.setattr(doctor_facts, "_version", lambda name: None if name == "no-such" else "0.70.1")
    assert doctor_facts.read_misfits() == {"numba": "<0.69,>=0.62", "click": ">=8.1.7"}


def test_a_library_that_cannot_be_imported_is_told_with_why(monkeypatch):
    monkeypatch.setitem(sys.modules, "xxhash", None)
    assert list(doctor_facts.read_faults()) == ["xxhash"]
    assert doctor_facts.read_faults()["xxhash"].startswith("ModuleNotFoundError: ")


def test_variables_that_are_set_are_told(monkeypatch):
    monkeypatch.setenv("RAYGRID_NATIVE_LINKS", "0")
    monkeypatch.setenv("UNRELATED", "x")
    found = doctor_facts.read_environment()
    assert found["RAYGRID_NATIVE_LINKS"] == "0"
    assert "UNRELATED" not in found


# --- fast paths --------------------------------------------------------------------------------------


def test_links_served_by_python_are_told_with_why(monkeypatch):
    monkeypatch.setattr(zmq_c_api, "_look_for_functions", lambda: (None, "RAYGRID_NATIVE_LINKS=0 asks for it"))
    found = doctor_facts.read_fast_paths()["native links"]
    assert (found["on"], found["why"]) == (False, "RAYGRID_NATIVE_LINKS=0 asks for it")


@pytest.mark.parametrize(
    ("statistics", "sealed", "why"),
    [
        (1, True, "NUMBA_NRT_STATS asks for it"),
        (0, True, "numba .* loads kernels in a way that is not known here"),
        (0, False, "numba .* keeps kernels in a way that is not known here, so none are kept"),
    ],
)
def test_kernels_loaded_by_numba_alone_are_told_with_why(monkeypatch, statistics, sealed, why):
    monkeypatch.setattr(fast_load, "can_load_alone", lambda: False)
    monkeypatch.setattr(fast_load, "can_seal", lambda: sealed)
    monkeypatch.setattr(fast_load.config, "NRT_STATS", statistics)
    found = doctor_facts.read_fast_paths()["fast kernel loading"]
    assert not found["on"]
    assert re.fullmatch(why, found["why"])


def test_without_a_compiler_nothing_is_loaded(monkeypatch):
    monkeypatch.setattr(fast_load.config, "DISABLE_JIT", 1)
    found = doctor_facts.read_fast_paths()
    for name in ("compiled kernels", "fast kernel loading"):
        assert found[name]["why"] == "NUMBA_DISABLE_JIT asks for it"


@pytest.mark.parametrize(
    ("features", "bits", "on"), [("+sse2,+avx2,+avx512f", 512, True), ("+avx2", 256, True), ("+sse2,-avx2", 128, False)]
)
def test_the_width_of_vectors(monkeypatch, features, bits, on):
    monkeypatch.setattr(fast_load.config, "CPU_FEATURES", features)
    found = doctor_facts.read_fast_paths()["vectors"]
    assert f"registers of {bits} bits" in found["what"]
    assert found["on"] == on
    assert (found["why"] is None) == on


# --- kernel cache ------------------------------------------------------------------------------------


def place(base: Path) -> Path:
    return base / f"kernels-{cache.digest()}"


def shared(base: Path) -> Path:
    """A directory in which anybody may write."""
    (base / "shared").mkdir()
    (base / "shared").chmod(0o777)
    return base / "shared"


def below_a_file(base: Path) -> Path:
    (base / "file").touch()
    return base / "file" / "cache"


def linked(base: Path) -> Path:
    """Below a link to a directory of one's own."""
    (base / "link").symlink_to(base)
    return base / "link" / "cache"


BASES = {  # how it stands -> a base of that kind below a directory
    "not there": lambda base: base / "new" / "cache",
    "there": lambda base: base,
    "a file": lambda base: below_a_file(base).parent,
    "below a file": below_a_file,
    "anybody's": shared,
    "below anybody's": lambda base: shared(base) / "cache",
    "below a link": linked,
}


@pytest.mark.parametrize("kind", BASES)
def test_the_place_is_the_one_that_the_next_run_takes(kind, tmp_path, monkeypatch):
    """Told before it is there and after; and looking makes nothing."""
    bases = [BASES[kind](tmp_path), tmp_path / "second"]
    monkeypatch.setattr(cache, "bases", lambda: iter(bases))
    before = sorted(tmp_path.rglob("*"))
    expected = doctor_facts.read_cache()
    assert sorted(tmp_path.rglob("*")) == before
    taken = cache._keeping()
    found = doctor_facts.read_cache()
    for told in (expected, found):
        assert os.path.realpath(told["directory"]) == taken.directory
        assert told["writable"] == taken.writable
        assert (
            told["why"].count("kernels-")
            == taken.why.count("kernels-")
            == (kind not in ("not there", "there", "below a link"))
        )
    assert (expected["exists"], found["exists"]) == (False, True)


def test_a_cache_that_cannot_be_written(tmp_path, monkeypatch):
    place(tmp_path).mkdir(mode=0o700)
    monkeypatch.setenv("RAYGRID_CACHE", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda *_arguments, **_options: False)
    found = doctor_facts.read_cache()
    assert (found["directory"], found["exists"], found["writable"]) == (str(place(tmp_path)), True, False)


def test_nowhere_to_keep_kernels(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "bases", lambda: iter([tmp_path / "one", tmp_path / "two"]))
    monkeypatch.setattr(os, "access", lambda *_arguments, **_options: False)
    found = doctor_facts.read_cache()
    assert found["directory"] is None
    assert found["why"].count(f"it is not there, and {tmp_path} cannot be written") == 2


def test_what_is_kept_is_counted_by_kind(tmp_path, monkeypatch):
    monkeypatch.setenv("RAYGRID_CACHE", str(tmp_path))
    inner = place(tmp_path)
    other = tmp_path / f"kernels-{'0' * 16}"
    folders = {folder.partition("_")[0]: folder for folder in doctor_facts._folders()}
    kept = ["tracing/a.nbi", "tracing/a.1.nbc", "geometry/b.nbi", "timed/c.nbi", "simulator/d.nbi"]
    files = [f"{folders[name.partition('/')[0]]}/{name.partition('/')[2]}" for name in kept]
    files.append("tracing_0/of-a-copy-elsewhere.nbi")
    for path in [*(inner / name for name in files), inner / "program-1" / "tracing_0" / "e.nbi", other / "f"]:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.write_text("12345")
    found = doctor_facts.read_cache()
    assert found["functions"] == {"nodes": 2, "nodes that keep machine time": 1, "the simulator": 1}
    assert (found["programs"], found["bytes"], found["bytes_beside"]) == (1, 35, 5)


def test_looking_refuses_what_would_be_made(tmp_path):
    """In a process that has not imported the kernel cache yet, whose import makes a directory."""
    (tmp_path / "old").mkdir()
    look = f"""
import os, shutil
from raygrid.host.cli.doctor_facts import only_looking, read_cache, read_fast_paths
with only_looking():
    for act in (os.mkdir, os.rmdir, os.utime, shutil.rmtree):
        try:
            act({str(tmp_path / "old")!r})
        except OSError as error:
            print(error.strerror)
print(read_fast_paths()["fast kernel loading"]["on"], read_cache()["exists"], os.listdir({str(tmp_path)!r}))
os.mkdir({str(tmp_path / "after")!r})
"""
    environment = os.environ | {"RAYGRID_CACHE": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, timeout=60, env=environment)
    assert done.stdout.splitlines() == [*["here is only looked"] * 4, "True False ['old']"], done.stderr
    assert sorted(os.listdir(tmp_path)) == ["after", "old"]


def test_trust_is_that_of_the_cache_itself():
    assert cache.why_not_trusted is trusted_files.why_not_trusted


# --- limits and places -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "bound", "lack"),
    [
        (
            "descriptors",
            Bound(64, "RLIMIT_NOFILE (ulimit -n)"),
            r"need 140 descriptors in the host, and RLIMIT_NOFILE .*",
        ),
        ("all_files", Bound(0, "fs.file-max"), r"need 340 open files, and fs.file-max leaves 0; nothing fits: .*"),
        ("tasks", Bound(-5, "pids.max of the control group"), r"need 27 processes .* leaves 0; nothing fits: .*"),
        ("memory", Bound(220_000_000, "the memory available"), r"need 312 MB .* leaves 220 MB; .* fits: 1x1x1: .*"),
    ],
)
def test_each_limit_that_leaves_too_little_is_told_with_what_helps(monkeypatch, name, bound, lack):
    monkeypatch.setattr(doctor_facts, "read_resources", lambda: replace(PLENTY, **{name: bound}))
    limits, lacks = doctor_facts.read_limits()
    assert len(lacks) == 1
    assert re.fullmatch(f"a 2x2x2 array does not fit this computer: its 8 processors {lack}", lacks[0]), lacks
    assert lacks[0].endswith(f": {doctor_facts.HELPS[name]}")
    assert limits[name]["left"] == max(bound.left, 0)
    assert limits[name]["largest"][0] < 2
    assert [one for one in limits if limits[one]["left"] is None] == [one for one in limits if one != name]


def test_without_limits_nothing_is_lacking(monkeypatch):
    monkeypatch.setattr(doctor_facts, "read_resources", lambda: PLENTY)
    limits, lacks = doctor_facts.read_limits()
    assert lacks == []
    assert list(limits) == ["descriptors", "all_files", "tasks", "memory"]


def test_directories_that_cannot_hold_sockets_are_told_with_why(monkeypatch):
    none = "/tmp/raygrid-tests/none"  # short: a path may be too long as well
    monkeypatch.setenv("XDG_RUNTIME_DIR", none)
    found = doctor_facts.read_places()
    assert found["sockets"][none] == "No such file or directory"
    assert found["temporary"] == tempfile.gettempdir()


def test_no_temporary_directory_at_all(monkeypatch):
    def none() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", none)
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/nowhere")
    found = doctor_facts.read_places()
    assert found["temporary"] is None
    assert list(found["sockets"]) == ["/nowhere", os.path.realpath("/tmp")]


def test_without_ffmpeg(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, SHIPS, None)
    assert doctor_facts.read_places()["ffmpeg"] is None
