"""Writes the reference of Python: what is to be documented, and docstrings in the form of this project as lists that HTML has."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import raygrid

PAGE = "reference/python.md"


class Entry(NamedTuple):
    """A name to be documented, and where it is."""

    kind: str  # of autodoc's directives
    name: str
    members: bool = True


def _of_raygrid(*names: str) -> list[Entry]:
    return [Entry(_kind(getattr(raygrid, name)), f"raygrid.{name}") for name in names]


def _kind(thing: Any) -> str:
    if not isinstance(thing, type):
        return "function"
    return "exception" if issubclass(thing, BaseException) else "class"


SECTIONS: dict[str, list[Entry]] = {
    "An array of one's own": _of_raygrid("launch", "Machine"),
    "Settings of a render": [
        Entry("class", "raygrid.host.render.given_settings.GivenFrame"),
        Entry("class", "raygrid.host.scene.view.GivenView"),
    ],
    "Pictures": _of_raygrid("Picture", "RenderProgress"),
    "Scenes": [*_of_raygrid("Scene", "load_scene"), Entry("class", "raygrid.LoadedScene", members=False)],
    "An array that stays": _of_raygrid("connect", "Service", "Submitted", "Result"),
    "An array that stays, from asyncio": [
        Entry("function", "raygrid.aio.connect"),
        Entry("class", "raygrid.aio.AsyncService"),
        Entry("class", "raygrid.aio.AsyncSubmitted"),
    ],
    "Either array": _of_raygrid("Renderer"),
    "Machine time": [
        *_of_raygrid("predict", "Prediction"),
        Entry("class", "raygrid.host.machine_time.predict.Estimate"),
    ],
    "Errors and remarks": _of_raygrid("RaygridError", "SceneError", "ArrayError", "OutputError", "RemarkWarning"),
}
GIVEN = ("Machine", "Picture", "Service", "Submitted", "AsyncService", "AsyncSubmitted", "Result", "Prediction", "LoadedScene",
         "Estimate", "Renderer")  # classes whose objects raygrid makes  # fmt: skip
TITLED = re.compile(r"(\S(?:.*?\S)?)\s{2,}(\S.*)")  # what an item is, and what is said of it


def python_page() -> str:
    """The page, as directives for autodoc. Raises ValueError for a public name that stands in no section."""
    documented = {entry.name.removeprefix("raygrid.") for entries in SECTIONS.values() for entry in entries}
    if missing := set(raygrid.__all__) - documented - {"aio"}:
        raise ValueError(f"SECTIONS of docs/site/python_pages.py lack {sorted(missing)}, wanted all of raygrid.__all__")
    parts = [
        "# Python",
        "All public names with their docstrings. [The Python interface](../python.md) tells how they are used.",
    ]
    for title, entries in SECTIONS.items():
        parts += [f"## {title}", *map(_directive, entries)]
    return "\n\n".join(parts) + "\n"


def _directive(entry: Entry) -> str:
    options = ["   :members:"] if entry.members and entry.kind != "function" else []
    return "\n".join(["```{eval-rst}", f".. auto{entry.kind}:: {entry.name}", *options, "```"])


def name_as_public() -> None:
    """Let classes be called as raygrid gives them out: autodoc takes those of another name for aliases."""
    for public in raygrid.__all__:
        thing = getattr(raygrid, public)
        if isinstance(thing, type):
            thing.__name__ = thing.__qualname__ = public
    importlib.import_module("raygrid.aio")


def process_signature(_app: Any, kind: str, name: str, _thing: Any, _options: Any, signature: str, back: str) -> Any:
    """Leave out how objects are made that raygrid makes itself."""
    if kind == "class" and name.rpartition(".")[2] in GIVEN:
        return "", back
    return signature, back


def process_docstring(_app: Any, _kind: str, _name: str, _thing: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = restructured(lines)


def restructured(lines: list[str]) -> list[str]:
    """A docstring as reStructuredText: paragraphs, indented examples, and columns "name  what it is" as a list."""
    made: list[str] = []
    for kind, text in _parts(lines):
        if kind == "example":
            made += ["::", "", *(f"    {line}" for line in text), ""]
        elif kind == "item":
            titled = TITLED.match(text[0])
            assert titled is not None
            made += [f"``{titled[1]}``", "    " + _plain(" ".join((titled[2], *text[1:]))), ""]
        else:
            made += [_plain(" ".join(text)), ""]
    return made


def _parts(lines: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Kind and lines of each part: an item with its indented lines, an example, or text."""
    kind, part = "", list[str]()
    for line in [*lines, ""]:
        indented = line.startswith("  ")
        titled = not indented and TITLED.fullmatch(line.rstrip()) is not None
        if not line.strip():
            now = ""
        elif kind == "item" and indented:
            now = "item"
        elif indented:
            now = "example"
        else:
            now = "item" if titled else "text"
        if part and (now != kind or titled):
            yield kind, part
            part = []
        if now:
            part.append(line.strip() if now != "example" else line[4:])
        kind = now


def _plain(text: str) -> str:
    """Text in which nothing but code in backticks is markup, with the documents that it names as links."""
    parts = re.split(r"(`[^`]+`)", text)
    return "".join(f"`{part}`" if part.startswith("`") and len(part) > 1 else _linked(part) for part in parts)


def _linked(text: str) -> str:
    return re.sub(r"docs/([\w-]+)\.md", r":doc:`\1 </\1>`", re.sub(r"([\\*|_`])", r"\\\1", text))
