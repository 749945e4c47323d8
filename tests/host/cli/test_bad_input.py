"""Misuse, outputs that cannot be written, too little of something: one clear line, exit code 1 (failed) or 2 (misused).

Nothing is left behind. Where, what came, what was wanted: each row of these tables has the whole line as a pattern.
"""

import json
import os
import re
import resource
from pathlib import Path

import numpy as np
import pytest
from support.cli import TINY, as_process, here, misused, one_line, warm_kernels

from raygrid.host.image import outputs

__all__ = ["warm_kernels"]

pytestmark = pytest.mark.usefixtures("no_leftovers")

GOOD = Path(TINY).read_text()
PICTURES = ".png .jpg .jpeg .webp .tif .tiff .bmp .ppm .tga .jp2 .pfm .hdr .exr .npy"


def refused(outcome, code, line):
    """By `raygrid render`, in one line: as misuse, or as what has failed."""
    misused(outcome, "render", line) if code == 2 else one_line(outcome, code, f"raygrid: {line}")


WHOLE, SIDES = "wanted a whole number from", "wanted sides of 1 to 65536 and at most 268,435,456 pixels"
CUBE = "wanted three numbers from 1 to 65535, such as 4x4x4, or 4x4x1 for a square array"
MISUSE = [  # arguments after "raygrid render SCENE", the line between "raygrid render: " and where to read more
    (["--size", "0x0"], f"--size: '0x0' came, {SIDES}"),
    (["--size", "5x0"], f"--size: '5x0' came, {SIDES}"),
    (["--size", "-5x5"], "--size: '-5x5' came, wanted two whole numbers such as 512x384"),
    (["--size", "512"], "--size: '512' came, wanted two whole numbers such as 512x384"),
    (["--size", "1e3x1e3"], "--size: '1e3x1e3' came, wanted two whole numbers such as 512x384"),
    (["--size", "9" * 5000 + "x1"], rf"--size: '9{{37}}\.\.\.' came, {SIDES}"),
    (["--samples", "0"], f"--samples: '0' came, {WHOLE} 1 to 4294967296"),
    (["--samples", "many"], f"--samples: 'many' came, {WHOLE} 1 to 4294967296"),
    (["--samples", "1.5"], f"--samples: '1.5' came, {WHOLE} 1 to 4294967296"),
    (["--samples", "9" * 30], f"--samples: '9{{30}}' came, {WHOLE} 1 to 4294967296"),
    (["--depth", "0"], f"--depth: '0' came, {WHOLE} 1 to 31"),
    (["--depth", "32"], f"--depth: '32' came, {WHOLE} 1 to 31"),
    (["--min-weight", "nan"], r"--min-weight: 'nan' came, wanted a number from 0.0 to 1e\+30"),
    (["--min-weight", "-1"], r"--min-weight: '-1' came, wanted a number from 0.0 to 1e\+30"),
    (["--batch", "0"], f"--batch: '0' came, {WHOLE} 1 to 8192"),
    (["--budget", "0"], f"--budget: '0' came, {WHOLE} 1 to 4294967295"),
    (["--patience", "inf"], "--patience: 'inf' came, wanted a number from 0.1 to 1000000000.0"),
    (["--array", "0x2x2"], f'--array: array shape "0x2x2" has 0 cells on an axis, {CUBE}'),
    (["--array", "2x2"], f'--array: array shape "2x2" has 2 parts, {CUBE}'),
    (["--array", "axbxc"], f'--array: array shape "axbxc" has "a" for a number, {CUBE}'),
    (["--array", "-1x2x2"], f'--array: array shape "-1x2x2" has "-1" for a number, {CUBE}'),
    (["--split", "fair"], "--split: 'fair' is not one of 'balanced', 'uniform'."),
    (["--transfer", "gamma"], "--transfer: 'gamma' is not one of 'srgb', 'linear'."),
    (["--sise", "4"], r"No such option '?--sise'?\..*--size.*"),
    (["--frames", "1-2", "--profile"], "--profile, .* came with several frames, wanted a single one"),
    (["--frames", "1-2", "--timed"], "--timed came with --frames, .* wanted one frame without a program"),
    (["other.nff"], r"Got unexpected extra argument \(other.nff\)"),
]


@pytest.mark.parametrize(("arguments", "line"), MISUSE, ids=[" ".join(row[0])[:30] for row in MISUSE])
def test_misused_options(arguments, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one_line(here("render", TINY, *arguments), 2, rf"raygrid render: {line} \(raygrid render --help says more\)")
    assert list(tmp_path.iterdir()) == []


def test_misused_commands():
    one_line(here("rendr"), 2, r"raygrid: No such command 'rendr'\..* \(raygrid --help says more\)")
    one_line(here("render"), 2, r"raygrid render: Missing argument 'SCENE'\. \(raygrid render --help says more\)")
    one_line(here("render", TINY, "--size"), 2, r"raygrid.*: Option '--size' requires an argument\. .*")
    one_line(here("info", TINY, "--samples", "3"), 2, r"raygrid info: No such option '?--samples'?.*")


TOO_MUCH = [  # arguments, the code, the line
    (["--size", "100000x100000"], 2, f"--size: '100000x100000' came, {SIDES}"),
    (["--size", "40000x40000"], 2, f"--size: '40000x40000' came, {SIDES}"),
    (
        ["--samples", "4000000000"],
        2,
        r"4000000000 samples a pixel came, wanted 1 to 65536 for 256x256 \(sample numbers have 32 bits\)",
    ),
    (
        ["--array", "1000x1000x1000"],
        1,
        r"a 1000x1000x1000 array does not fit this computer: its 1000000000 processors need .+, and .+ leaves .+; largest that fits: (\d+)x\1x\1",
    ),
    (
        ["--size", "20000x100", "-o", "x.webp"],
        2,
        "x.webp: the picture has 20000x100 pixels, wanted sides of at most 16383 for WEBP",
    ),
    (
        ["--size", "100x65501", "-o", "x.jpg"],
        2,
        "x.jpg: the picture has 100x65501 pixels, wanted sides of at most 65500 for JPEG",
    ),
]


@pytest.mark.parametrize(("arguments", "code", "line"), TOO_MUCH, ids=[" ".join(row[0]) for row in TOO_MUCH])
def test_what_is_too_large(arguments, code, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(here("render", TINY, *arguments), code, line)
    assert list(tmp_path.iterdir()) == []


NO_OUTPUTS = [  # arguments, the line, of what no output can be called
    (["-o", ""], "--output: '' came, wanted the name of a file"),
    (["-o", "x"], f"x: the output has no suffix, wanted one of: {PICTURES}"),
    (["-o", "x.xyz"], f"x.xyz: the output has the suffix '.xyz', wanted one of: {PICTURES}"),
    (["-o", "x.h5"], f"x.h5: the output has the suffix '.h5', wanted one of: {PICTURES}"),
]
OUTPUTS = [  # arguments, the line
    (["-o", "gone/x.png"], r"gone/x.png: there is no directory .*/gone, wanted one that is there"),
    (["-o", "."], ".: the output is a directory, wanted a file"),
    (["-o", "folder.png"], "folder.png: the output is a directory, wanted a file"),
    (["-o", "/proc/x.png"], r"/proc/x.png: no such file can be made in /proc \(.+\)"),
    (["-o", "a" * 300 + ".png"], r"a{300}.png: no such file can be made in .+ \(File name too long\)"),
    (["-o", "x.png", "-o", "x.png"], "x.png: the output is the same file as the output x.png, wanted another"),
    (["-o", "x.npy", "--stats", "x.npy"], "x.npy: the output is the same file as the output x.npy, wanted another"),
    (["-o", "x.png", "--stats", "tiny.nff"], "tiny.nff: the output is the same file as the scene, wanted another"),
    (["-o", "x.png", "--stats", "."], ".: the output is a directory, wanted a file"),
    (["-o", "x.png", "--stats", "gone/x.json"], "gone/x.json: there is no directory .*/gone, wanted one that is there"),
    (["-o", "locked.png"], "locked.png: the output is write-protected, wanted a file that may be replaced"),
    (["-o", "locked/x.png"], r"locked/x.png: no such file can be made in .*/locked \(Permission denied\)"),
]


@pytest.mark.parametrize(
    ("arguments", "line", "code"),
    [*((*row, 2) for row in NO_OUTPUTS), *((*row, 1) for row in OUTPUTS)],
    ids=[" ".join(row[0])[:40] for row in (*NO_OUTPUTS, *OUTPUTS)],
)
def test_outputs_are_looked_at_before_anything_is_done(arguments, line, code, tmp_path, monkeypatch):
    if "locked" in line and os.geteuid() == 0:
        pytest.skip("nothing is write-protected for root")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("raygrid.host.cli.commands.render_request.Array", None)  # would be called to render
    (tmp_path / "tiny.nff").write_text(GOOD)
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "locked").mkdir(mode=0o555)
    (tmp_path / "locked.png").touch(mode=0o444)
    refused(here("render", "tiny.nff", *arguments), code, line)
    assert {path.name for path in tmp_path.iterdir()} == {"tiny.nff", "folder.png", "locked", "locked.png"}


@pytest.mark.usefixtures("warm_kernels")
@pytest.mark.parametrize("name", ["full.png", "full.npy"])
def test_a_full_disk(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path(name).symlink_to("/dev/full")
    one_line(
        here("render", TINY, "--size", "9x9", "-o", name),
        1,
        rf"raygrid: {name}: the file cannot be written \(No space left on device\)",
    )
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.usefixtures("warm_kernels")
def test_a_disk_that_fills_up_leaves_no_part_of_a_file(tmp_path):
    """As a limit on the size of files, which are larger than that at 200x200 pixels."""

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    outcome = as_process("render", TINY, "--size", "200x200", "-o", "x.npy", cwd=tmp_path, preexec_fn=limit)
    one_line(outcome, 1, r"raygrid: x.npy: the file cannot be written \(File too large\)")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_replace_another_is_removed(tmp_path, monkeypatch):
    def refuse(_source, _target):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(outputs.OutputError, match=r"x\.npy: the file cannot be written \(Permission denied\)$"):
        outputs.write_whole(tmp_path / "x.npy", lambda file: file.write(b"x"))
    assert list(tmp_path.iterdir()) == []


def test_the_temporary_directory_is_unusable(tmp_path, monkeypatch):
    """Directories for sockets are tried in turn; the line names each with what is wrong. /tmp is the last resort, so
    it has to be made unusable, too."""
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(deep))
    monkeypatch.setattr(
        "raygrid.emulator.topology.socket_directory.bases", lambda: [str(deep), "/proc", "/nowhere/gone"]
    )
    outcome = here("render", TINY, "-o", str(tmp_path / "x.png"))
    too_long = rf"{deep} \(its socket paths would have \d+ bytes, at most 107 are allowed\)"
    line = rf"raygrid: no directory for the sockets of the array: {too_long}, /proc \(.+\), .*/gone \(No such file or directory\); wanted .+: set XDG_RUNTIME_DIR or TMPDIR"
    one_line(outcome, 1, line)


@pytest.mark.usefixtures("warm_kernels")
def test_a_temporary_directory_that_is_unusable_is_passed_over(tmp_path):
    """If it is too deep for sockets, or no file can be made there."""
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    for unusable in (str(deep), "/proc"):
        environment = {"TMPDIR": unusable, "XDG_RUNTIME_DIR": unusable}
        outcome = as_process("render", TINY, "--size", "9x9", "-o", "x.png", cwd=tmp_path, environment=environment)
        assert outcome == (0, "x.png\n", "")


@pytest.mark.parametrize("descriptors", [40, 130])
def test_few_descriptors(descriptors, tmp_path):
    def limit():
        resource.setrlimit(resource.RLIMIT_NOFILE, (descriptors, descriptors))

    outcome = as_process("render", TINY, "--array", "3x3x3", "-o", "x.png", cwd=tmp_path, preexec_fn=limit)
    fits = r"(nothing fits|largest that fits: \dx\dx\d)"
    one_line(
        outcome,
        1,
        rf"raygrid: a 3x3x3 array does not fit this computer: its 27 processors need \d+ descriptors in the host, and RLIMIT_NOFILE \(ulimit -n\) leaves {descriptors}; {fits}",
    )
    assert list(tmp_path.iterdir()) == []


def test_standard_output_that_is_full():
    with open("/dev/full", "w") as full:
        outcome = as_process("info", TINY, stdout=full)
    assert outcome.code == 1
    assert re.fullmatch(r"raygrid: standard output cannot be written \(No space left on device\)\n", outcome.err)


# ---- errors of our own, and --debug ----


@pytest.mark.parametrize("where", ["before", "after", "variable"])
def test_debug_shows_the_traceback(where, monkeypatch):
    monkeypatch.setenv("RAYGRID_DEBUG", "1" if where == "variable" else "")
    arguments = {"before": ["--debug", "info", "gone.nff"], "after": ["info", "gone.nff", "--debug"]}
    outcome = here(*arguments.get(where, ["info", "gone.nff"]))
    assert outcome.code == 1
    assert outcome.err.startswith("Traceback (most recent call last):\n")
    assert outcome.err.endswith("\nraygrid: gone.nff: there is no such file\n")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (
            ZeroDivisionError("division\nby zero"),
            r"a bug: ZeroDivisionError: division by zero \(raygrid --debug shows where\)",
        ),
        (MemoryError(), "out of memory"),
    ],
    ids=["bug", "memory"],
)
def test_other_errors_are_one_line_too(error, line, monkeypatch):
    def fail(_path):
        raise error

    monkeypatch.setattr("raygrid.host.scene.load.load_scene", fail)
    one_line(here("info", TINY), 1, f"raygrid: {line}")


def test_a_picture_larger_than_the_memory(monkeypatch, tmp_path):
    """Told before the kernel would end a process for it."""
    from raygrid.emulator.topology.limits import Bound, Resources

    plenty = Bound(1 << 40, "no limit")
    few = Resources(plenty, plenty, plenty, Bound(5_000_000, "memory.max of the control group"))
    monkeypatch.setattr("raygrid.host.render.frame.read_memory", lambda: few.memory)
    outcome = here("render", TINY, "--size", "1000x1000", "-o", str(tmp_path / "x.png"))
    one_line(
        outcome,
        1,
        r"raygrid: a picture of 1000x1000 pixels needs 0\.1 GB of memory, and memory\.max of the control group leaves 0\.0 GB",
    )
    outcome = here("render", TINY, "--size", "1000x1000", "--layers", "depth", "-o", str(tmp_path / "x.png"))
    one_line(outcome, 1, r"raygrid: a picture of 1000x1000 pixels needs 0\.2 GB of memory, .*")


def test_numbers_as_numpy_writes_them_are_no_obstacle(tmp_path):
    """`.npy` in, statistics in JSON out: both are read back by strangers."""
    output, stats = tmp_path / "x.npy", tmp_path / "x.json"
    assert here("render", TINY, "--size", "5x4", "-o", str(output), "--stats", str(stats)).code == 0
    assert np.load(output, allow_pickle=False).shape == (4, 5, 3)
    assert json.loads(stats.read_text())["size"] == [5, 4]


@pytest.mark.parametrize("command", ["render", "info", "simulate", "export", "jam", "submit"])
def test_a_directory_is_no_scene(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one_line(here(command, "."), 1, r"raygrid: \.: the scene is a directory, wanted a file of one of: \.nff .+")
    assert list(tmp_path.iterdir()) == []
