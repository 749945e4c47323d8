"""What README, docs and help say can be typed: every line parses and names files that are there, and marked ones run."""

from __future__ import annotations

import re
from pathlib import Path

import click
import pytest
from support.cli import as_process, here, warm_kernels
from support.docs import (
    PAGES,
    ROOT,
    Line,
    documented,
    files_of,
    lines_of,
    marked,
    names_up,
    of_help,
    shown_outputs,
    small,
)

from raygrid.host.cli.main import cli
from raygrid.host.image.ffmpeg import find_ffmpeg
from raygrid.host.scene.load import READERS

__all__ = ["warm_kernels"]

LINES = [*documented(), *of_help()]
MARKED = {page: marked(page) for page in PAGES}
SITTINGS = [pytest.param(lines, page, id=lines[0].where) for page, lists in MARKED.items() for lines in lists]
WRITTEN = {name for page in PAGES for name in files_of(page)}
# Scenes of the Standard Procedural Databases, which README says how to get, and measurements beside their commands.
ELSEWHERE = re.compile(
    r"(tetra|mount|balls|gears|rings|teapot|shells|jacks|lattice|tree)_\d+\.nff|\$RAYGRID_SHARED/.*|ring\.ply"
)
# Options in the docs that are those of other programs.
FOREIGN = {"--write", "--runs", "--rate", "--headless", "--editable"}


def shown(line: Line) -> str:
    return f"{line.where} {' '.join(line.words)}"[:70]


@pytest.mark.parametrize("line", LINES, ids=shown)
def test_every_line_parses_and_its_files_are_there(line):
    if line.words[0].startswith(("-", "COMMAND")):
        return
    command = cli.commands[line.words[0]]
    if "SCENE" in line.words or "--help" in line.words or any(word.isupper() and len(word) > 3 for word in line.words):
        named = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        assert {word for word in line.words if word.startswith("--")} <= named
        return
    context = command.make_context(line.words[0], line.words[1:], resilient_parsing=False)
    read = [context.params[name] for name in ("scene", "program") if context.params.get(name)]
    read += context.params.get("scenes") or ()
    for path in map(str, read):
        assert Path(path).suffix in (*READERS, ".py"), path
        known = (ROOT / path).is_file() or ELSEWHERE.fullmatch(path) or path in WRITTEN
        assert known, f"{line.where}: {path} is not shipped"


def test_the_lines_are_found():
    """So that no test above passes for want of lines."""
    assert len(documented()) > 50
    assert len(of_help()) > 30
    assert len(shown_outputs()) >= 2
    assert sum(len(lines) for lists in MARKED.values() for lines in lists) > 50
    page = "<!-- run -->\n```\nraygrid info x.nff      what is in it\n```\n\n    raygrid up && raygrid down  # both\n"
    assert [(line.words, line.runs) for line in lines_of(page, "x")] == [
        (["info", "x.nff"], True),
        (["up"], False),
        (["down"], False),
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_and_option_that_is_named_exists(page):
    text = page.read_text()
    for name in re.findall(r"`raygrid ([a-z]+)", text):
        assert name in cli.commands, name
    options = {option for command in cli.commands.values() for parameter in command.params
               for option in (*parameter.opts, *parameter.secondary_opts)}  # fmt: skip
    for code in re.findall(r"`([^`\n]+)`", text):
        if "bench" in code or "pip " in code or "python " in code:
            continue
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", code):
            assert option in options | {"--help"} | FOREIGN, f"{option} in `{code}`"


@pytest.mark.parametrize("command", list(cli.commands.values()), ids=lambda command: str(command.name))
def test_help_fits_a_terminal(command):
    """80 columns: no line of the examples or the epilog is cut or broken."""
    context = click.Context(command, info_name=f"raygrid {command.name}", terminal_width=80, max_content_width=80)
    long = [line for line in command.get_help(context).splitlines() if len(line) > 80]
    assert not long


def test_no_summary_of_a_command_is_cut():
    """Of a longer first sentence click shows the beginning, and "..."."""
    context = click.Context(cli, info_name="raygrid", terminal_width=80, max_content_width=80)
    listed = cli.get_help(context).split("Commands:\n")[1].split("\n\n")[0].splitlines()
    assert [line.split()[0] for line in listed] == sorted(cli.commands)
    assert not [line for line in listed if not line.endswith(".") or line.endswith("...")]


@pytest.mark.usefixtures("warm_kernels")
@pytest.mark.parametrize(
    ("page", "words", "shown"), shown_outputs(), ids=lambda part: "" if isinstance(part, str) else None
)
def test_a_page_shows_what_is_printed(page, words, shown, tmp_path, monkeypatch):
    """Each line of the block, in its order, with nothing made smaller; what is left out is wall time."""
    monkeypatch.chdir(tmp_path)
    for name, text in files_of(page).items():
        Path(name).write_text(text)
    printed = iter(here(*words).out.splitlines())
    assert not [line for line in shown.splitlines() if line not in printed]


@pytest.mark.timeout(900)  # kernels and a program are compiled, each a minute on a quiet computer
@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
@pytest.mark.parametrize(("lines", "page"), SITTINGS)
def test_marked_lines_run(lines, page, tmp_path, monkeypatch):
    """One after the other in one folder, as a reader would, with few pixels, frames and processors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    Path("scenes").symlink_to(ROOT / "scenes")
    Path("out").mkdir()
    for name, text in files_of(page).items():
        Path(name).write_text(text)
    try:
        for line in lines:
            if any(word.endswith(".mp4") for word in line.words) and find_ffmpeg() is None:
                continue
            outcome = here(*small(line.words))
            assert outcome.code == 0, f"{line.where}: raygrid {' '.join(small(line.words))}: {outcome.err}"
    finally:
        for name in names_up(lines):
            as_process("down", "--cancel", "--name", name)
