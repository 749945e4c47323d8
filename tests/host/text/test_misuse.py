"""Every option of every command with what it cannot be: exit code 2, one line, nothing written, nothing begun."""

from __future__ import annotations

import re
from pathlib import Path

import click
import pytest
from support.cli import here, misused, one_line
from support.render import SCENES

from raygrid.host.cli.group_inspect import PixelType
from raygrid.host.cli.group_service import ArrayNameType
from raygrid.host.cli.main import cli
from raygrid.host.cli.types import (
    EdgesType,
    FaultType,
    FileName,
    LayersType,
    NumberType,
    PairType,
    ShapeType,
)
from raygrid.host.cli.view_options import CameraName, NumbersType

TINY, MOBILE, RINGS = (str(SCENES / name) for name in ("tiny.nff", "mobile.toml", "rings.toml"))
TORUS = str(SCENES / "programs" / "torus.py")
WORDS = ["", " ", "no such", "-", "\udce9", "9" * 5000, "nan", "1e999", "0x10", "\u0661"]
PAIRS = ["0x0", "5x0", "-5x5", "512", "1e3x1e3", "5x5x5", "x", "65537x1", "65536x65536", "99999x99999"]
BAD: list[tuple[type[click.ParamType], list[str]]] = [
    (PairType, WORDS + PAIRS),
    (ShapeType, [*WORDS, "0x1x1", "2x2", "2x2x2x2", "axbxc", "-1x2x2", "2.5x1x1", "65536x1x1"]),
    (EdgesType, [*WORDS, "0", "1,,2", "1025", "1;2"]),
    (FaultType, [*WORDS, "drop:2", "drop:-1", "drop:0.1:x", "drop:nan", "burn:0.1"]),
    (PixelType, [*WORDS, "1", "1,2,3", "-1,0", "1.5,0"]),
    (ArrayNameType, ["", ".", "..", "a/b", "x" * 300, "\udce9", "a\0b"]),
    (FileName, ["", "a\0b"]),
    (NumbersType, [*WORDS, "1", "1,2", "1,2,3,4", "1,2,3,4,5,6,7", "1;2;3", "1,,2", "1,2,nan", "1,2,inf", "1,2,1e31"]),
    (CameraName, ["", "x" * 1001]),
    (LayersType, [*WORDS, "dept", "depth,", "depth,,normal", "depth;normal", "Depth"]),
    (click.Choice, WORDS),
]
# What a command needs besides the option under test.
NEEDED = {"trace": ["--pixel", "1,1"], "cancel": ["1"], "wait": ["1"], "load": [TORUS, "--allow-programs"]}
NO_SCENE = ("load", "up", "wait", "jobs", "cancel", "status", "reset", "down", "probe", "list", "doctor", "demo")


def arguments(name: str) -> list[str]:
    """A call of the command that is right."""
    return [name, *([] if name in NO_SCENE else [TINY]), *NEEDED.get(name, [])]


def bad_values(kind: click.ParamType) -> list[str]:
    """What an option of this type cannot be."""
    if isinstance(kind, NumberType):
        least, most = kind._least, kind._most
        return [*WORDS, str(least - 1), str(most * 2 + 1), "inf", *(["1.5"] if isinstance(least, int) else [])]
    found = [values for of, values in BAD if isinstance(kind, of)]
    if not found and type(kind).__name__ == "FramesType":
        return [*WORDS, "3-1", "1-2-3", "-1", "1-", "1.5"]
    return found[0] if found else []


def valued_options() -> list[tuple[str, str]]:
    """Every option with a value, of every command."""
    return [
        (name, parameter.opts[-1])
        for name, command in cli.commands.items()
        for parameter in command.params
        if isinstance(parameter, click.Option) and not parameter.is_flag and not parameter.count
    ]


@pytest.fixture(autouse=True)
def nothing_begins(tmp_path, monkeypatch):
    """No array is launched or asked, and nothing is written."""
    for name in ("render_request.Array", "load.Array", "up._start", "submit.Connection"):
        monkeypatch.setattr(f"raygrid.host.cli.commands.{name}", None)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    yield
    assert list((tmp_path / "here").iterdir()) == []


@pytest.mark.parametrize(("command", "option"), valued_options())
def test_no_option_takes_what_it_cannot_be(command, option):
    parameter = next(found for found in cli.commands[command].params if option in found.opts)
    values = bad_values(parameter.type)
    if option == "--cost":  # with --timed for render, and a name that is none, as elsewhere
        values = WORDS[1:]
    assert values, f"{command} {option}: a type of options without bad values: {parameter.type}"
    timed = ["--timed"] * (command == "render" and option in ("--cost", "--search"))
    for value in values:
        misused(here(*arguments(command), *timed, option, value), command, ".*(came|is not one of|cannot|wanted).*")


TOGETHER = [  # command, arguments after it, what is said of them
    ("render", [TINY, "--turntable", "2", "--turntable-scene", "2"], "--turntable and --turntable-scene came, .*"),
    ("submit", [TINY, "--turntable", "2", "--turntable-scene", "2"], "--turntable and --turntable-scene came, .*"),
    ("render", [TINY, "-o", "x.xyz"], "x.xyz: the output has the suffix '.xyz', wanted one of: .*"),
    ("submit", [TINY, "-o", "x.xyz"], "x.xyz: the output has the suffix '.xyz', wanted one of: .*"),
    ("simulate", [TINY, "-o", "x.xyz"], "x.xyz: the output has the suffix '.xyz', wanted one of: .*"),
    ("render", [TINY, "-o", "x"], "x: the output has no suffix, wanted one of: .*"),
    ("render", [MOBILE, "--frames", "1-2", "-o", "x.png"], "x.png: several frames would go to this one file, .*"),
    ("submit", [MOBILE, "--frames", "1-2", "-o", "x.png"], "x.png: several frames would go to this one file, wanted a number .*"),
    ("render", [MOBILE, "--frames", "1-2", "-o", "%d%d.png"], "%d%d.png: .*"),
    ("render", [MOBILE, "--frames", "1-2", "-o", "%d.xyz"], r"\d+.xyz: the output has the suffix .*"),
    ("render", [TINY, "--samples", "4294967295"], r"4294967295 samples a pixel came, wanted 1 to \d+ for .*"),
    ("simulate", [TINY, "--samples", "4294967295"], r"4294967295 samples a pixel came, wanted 1 to \d+ for .*"),
    ("render", [TINY, "--size", "20000x9", "-o", "x.webp"], "x.webp: the picture has 20000x9 pixels, wanted .*"),
    ("trace", [TINY, "--pixel", "256,0"], "a pixel came as 256,0, wanted 0,0 to 255,255"),
    ("trace", [TINY, "--pixel", "1,1", "--sample", "1"], "a sample came as 1, wanted 0 to 0"),
    ("render", [RINGS, "--program", TORUS], ".*torus.py: a program is code .*, wanted --allow-programs .*"),
    ("load", [TORUS], ".*torus.py: a program is code .*, wanted --allow-programs .*"),
    ("submit", [RINGS, "--program", "x.txt"], "x.txt: the program has the suffix '.txt', wanted .py"),
    ("render", [RINGS, "--program", "x.txt", "--allow-programs"], "x.txt: the program has the suffix '.txt', wanted .py"),
    ("load", ["x.txt", "--allow-programs"], "x.txt: the program has the suffix '.txt', wanted .py"),
    ("render", [TINY, "--cost", "8086"], "--cost and --search came without --timed"),
    ("render", [TINY, "--timed", "--cost", "z80"], "a cost model came as 'z80', wanted one of .*"),
    ("probe", ["--replay", "x", "--name", "y"], "--replay came with --name or --prometheus, .*"),
    ("schema", ["obj"], "kind: 'obj' is not one of .*"),
    ("completion", [], "Missing argument 'SHELL'.*"),
    ("completion", ["csh"], "shell: 'csh' is not one of .*"),
    ("simulate", [TINY, "--json", "--stats", "-"], "--json came with -, wanted one of them on standard output"),
    ("simulate", [TINY, "--json", "--csv", "-"], "--json came with -, wanted one of them on standard output"),
    ("cancel", [], "wanted either numbers of jobs or --all"),
    ("cancel", ["1", "--all"], "wanted either numbers of jobs or --all"),
    ("down", ["--kill", "--finish"], "--kill came with --finish or --cancel, wanted it alone"),
    *((name, ["x.xyz", *NEEDED.get(name, [])], "x.xyz: the .*suffix.* wanted one of: .*")
      for name in ("render", "info", "export", "trace", "jam", "simulate", "predict", "law", "submit")),
    *((name, ["", *NEEDED.get(name, [])], "a scene came as '', wanted the name of a file")
      for name in ("render", "info", "export", "trace", "jam", "simulate", "predict", "law", "submit")),
]  # fmt: skip


@pytest.mark.parametrize(("command", "after", "said"), TOGETHER, ids=lambda value: str(value)[:40])
def test_arguments_that_cannot_be_are_misuse(command, after, said, monkeypatch):
    if {"--size", "--samples", "--frames"} & set(after):
        monkeypatch.setattr("raygrid.host.cli.commands.render_request.Array", _Nothing)
    misused(here(command, *after), command, said)


class _Nothing:
    """Stands for an array where the scene is read before the fault can be seen."""

    def __init__(self, *_arguments: object, **_options: object) -> None:
        self.shape = (2, 2, 2)

    def __enter__(self) -> _Nothing:
        return self

    def __exit__(self, *_error: object) -> None:
        pass

    def begin(self) -> None:
        pass

    wait_warm = wait_ready = begin


@pytest.mark.parametrize(
    ("command", "hint"),
    [
        ("render", r"\(--program\)"),
        ("simulate", "which raygrid simulate does not run: raygrid render --program does"),
        ("trace", "which raygrid trace does not run: raygrid render --program does"),
        ("jam", "which raygrid jam does not run: raygrid render --program does"),
    ],
)
def test_a_program_that_is_wanted_is_told_by_the_option_that_the_command_has(command, hint, monkeypatch):
    """It failed: simulate, trace and jam advised an option that they have not."""
    monkeypatch.setattr("raygrid.host.cli.commands.render_request.Array", _Nothing)
    outcome = here(command, RINGS, *NEEDED.get(command, []))
    one_line(
        outcome, 1, rf"raygrid: rings.toml: \d+ surfaces of a program came, wanted a program with surface_hits.*{hint}"
    )
    for option in re.findall(r"(?<!render )--[a-z-]+", outcome.err):
        assert any(option in parameter.opts for parameter in cli.commands[command].params), option


FAILS = [  # what depends on files, the computer or an array has failed, and is no misuse
    ["render", "gone.nff"],
    ["info", "gone.toml"],
    ["render", TINY, "-o", "gone/x.png"],
    ["render", TINY, "--array", "1000x1000x1000"],
    ["simulate", TINY, "--cost", "gone.toml"],
    ["render", MOBILE, "--frames", "40-60", "-o", "%d.png"],
    ["render", MOBILE, "--turntable", "3", "-o", "%d.png"],
    ["status"],
    ["probe", "--replay", "gone.jsonl"],
    ["submit", str(Path("gone.nff"))],
]


@pytest.mark.parametrize("words", FAILS, ids=" ".join)
def test_what_depends_on_the_world_has_failed(words, monkeypatch):
    if words[1:2] == [MOBILE]:
        monkeypatch.setattr("raygrid.host.cli.commands.render_request.Array", _Nothing)
    if "--array" in words:
        monkeypatch.undo()
    one_line(here(*words), 1, "raygrid: .*")
