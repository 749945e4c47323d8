"""The `raygrid` lines of README.md and docs/*.md, and of the help: what they say is what can be typed."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

from raygrid.host.cli.main import cli
from support import paths

ROOT = paths.ROOT
RUN = "<!-- run -->"  # before a block of code: its lines are run, small
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FILE = re.compile(r"^<!-- file: (\S+) -->\n```\w*\n(.*?)^```", re.M | re.S)  # what the reader is to put into a file
SNIPPET = re.compile(
    r"^```python\n(.*?)^```(?:\n\n<!-- output -->\n```\n(.*?)^```)?", re.M | re.S
)  # and what it prints
OUTPUT = re.compile(r"^<!-- output of: (raygrid [^\n]*) -->\n```\n(.*?)^```", re.M | re.S)
SMALL = {"640, 480": "64, 48", "800, 600": "64, 48", "frames=(1, 48)": "frames=(1, 2)", '"2x2x2"': '"2x1x1"'}
COMMENT = re.compile(r"\s+#\s.*$|\s{3,}\S.*$")  # what a line says of itself, behind it


class Line(NamedTuple):
    """A `raygrid` line, as words without `raygrid`."""

    where: str
    words: list[str]
    runs: bool
    block: int = 0


def lines_of(text: str, name: str) -> list[Line]:
    """The lines in fenced and indented blocks of a page."""
    found, fenced, runs, before, block = [], False, False, "", 0
    for number, line in enumerate(re.sub(r" \\\n\s*", " ", text).splitlines(), 1):
        if line.startswith("```"):
            fenced = not fenced
            block += fenced
            runs = fenced and before == RUN
        elif fenced or line.startswith("    "):
            if not fenced and not before.startswith("    "):  # the first line of an indented block
                runs = before == RUN
                block += 1
            commands = re.split(r"\s&&\s|\s\|\s", COMMENT.sub("", line.strip()))
            typed = [shlex.split(command)[1:] for command in commands if command.startswith("raygrid ")]
            found += [Line(f"{name}:{number}", words, runs, block) for words in typed]
        if line.strip():
            before = line if line.startswith("    ") and not fenced else line.strip()
    return found


def files_of(page: Path) -> dict[str, str]:
    """Files that a page lets its reader write, name -> text. Who reads a tutorial has those of the others."""
    pages = sorted(page.parent.glob("*.md")) if is_tutorial(page) else [page]
    return dict(found for one in pages for found in FILE.findall(one.read_text()))


def snippets(page: Path) -> list[tuple[str, str]]:
    """The Python blocks of a page, with few pixels, frames and processors, and what each prints, if the page shows it."""
    found = SNIPPET.findall(page.read_text())
    for large, little in SMALL.items():
        found = [(snippet.replace(large, little), shown) for snippet, shown in found]
    return found


def shown_outputs() -> list[tuple[Path, list[str], str]]:
    """Page, words and output of the commands whose output a page shows."""
    return [(page, shlex.split(line)[1:], shown) for page in PAGES for line, shown in OUTPUT.findall(page.read_text())]


def is_tutorial(page: Path) -> bool:
    """Whether a page is gone through from its beginning to its end."""
    return page.parent.name == "tutorials"


def documented() -> list[Line]:
    """All lines of README and docs."""
    return [line for page in PAGES for line in lines_of(page.read_text(), page.name)]


def sittings(lines: list[Line]) -> list[list[Line]]:
    """Marked lines by block, and what is between an `up` and its `down` in one: what a reader does in one go."""
    found: list[list[Line]] = []
    for line in lines:
        last = [before.words[0] for before in found[-1]] if found else []
        together = found and (found[-1][-1].block == line.block or last.count("up") > last.count("down"))
        if together:
            found[-1].append(line)
        else:
            found.append([line])
    return found


def marked(page: Path) -> list[list[Line]]:
    """The marked lines of a page by what a reader does in one go: all of a tutorial, else as `sittings` has them."""
    lines = [line for line in lines_of(page.read_text(), page.name) if line.runs]
    return [lines] if lines and is_tutorial(page) else sittings(lines)


def names_up(lines: list[Line]) -> list[str]:
    """Names of the arrays that these lines launch to stay."""
    ups = [line.words for line in lines if line.words[0] == "up"]
    return [words[words.index("--name") + 1] if "--name" in words else "default" for words in ups]


def of_help() -> list[Line]:
    """All examples of --help."""
    texts = {"raygrid": cli.epilog or ""} | {name: command.epilog or "" for name, command in cli.commands.items()}
    return [
        Line(f"{name} --help", shlex.split(found)[1:], False)
        for name, text in texts.items()
        for found in re.findall(r"^ +(raygrid .+)$", re.sub(r" \\\n\s*", " ", text), re.M)
    ]


def small(words: list[str]) -> list[str]:
    """The same command with few pixels, frames and processors."""
    command, words = words[0], list(words)
    drawing = command in ("render", "submit", "simulate", "trace", "jam", "demo")
    least = {"--array": "2x1x1", "--samples": "1", "--square": "1,2,3", "--cubic": "1,2,3", "--turntable": "2"}
    least |= {"--turntable-scene": "2", "--size": "16x16"}
    for k, word in enumerate(words[:-1]):
        if word in least and not (word == "--size" and command == "law"):
            words[k + 1] = least[word]
        if word == "--frames" and "-" in words[k + 1]:
            words[k + 1] = f"{words[k + 1].split('-')[0]}-{int(words[k + 1].split('-')[0]) + 1}"
        if word == "--prometheus":
            words[k + 1] = "0"
    if drawing and "--size" not in words and command != "trace":
        words += ["--size", "16x16"]
    if command == "probe" and "--for" not in words and "--replay" not in words:
        words += ["--for", "0.5"]
    return words
