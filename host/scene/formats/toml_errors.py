"""Turns pydantic's errors about a scene file into one sentence: file, line, key, what came, what was wanted."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import AliasChoices, BaseModel, ValidationError
from pydantic_core import ErrorDetails

from raygrid.host.scene.builder import shown
from raygrid.host.scene.formats.toml_schema import KEYS, TABLES, SceneFile
from raygrid.node.errors import SceneError

Key = tuple[str | int, ...]

LENGTHS = ("min_length", "max_length")
HEADER = re.compile(r"\s*\[(\[?)\s*([^\]]+?)\s*\]")
LONGEST_LINE = 500  # that is looked at: the header of blanks alone takes time by the square of its length
ASSIGNMENT = re.compile(r"\s*([\w.-]+|\"[^\"]*\")\s*=")


def checked(path: Path, text: str, tables: dict[str, object], number: int = 0) -> SceneFile:
    """The tables of a file as a SceneFile; raises SceneError for the first fault.

    text    for the line number
    number  what the first table of a list is called there
    """
    try:
        return SceneFile.model_validate(tables)
    except ValidationError as error:
        faults = error.errors(include_url=False)
    # A misspelt key is also a missing one: the first says more.
    unknown = [fault for fault in faults if fault["type"] == "extra_forbidden"]
    raise SceneError(_sentence(path, text, tables, (unknown or faults)[0], number))


def check_item(where: str, tables: dict[str, object], number: int = 0) -> SceneFile:
    """Check one table of a list, or what else `tables` has, as a file of it alone. Raises SceneError for the first fault.

    number  what the table is called in its list, if it is in one
    """
    return checked(Path(where), "", tables, number)


def _sentence(path: Path, text: str, tables: dict[str, object], fault: ErrorDetails, number: int) -> str:
    key, tag = _without_tags(fault["loc"], tables)
    if number and len(key) > 1 and key[1] == 0:
        key = (key[0], number, *key[2:])
    where, name = located(path, text, key), shown_key(key)
    kind, message = fault["type"], fault["msg"]
    if kind == "missing":
        return f"{where}: {name} is missing"
    if kind == "extra_forbidden":
        tables_of = KEYS if "keys" in key[:-1] else TABLES
        model = tables_of.get(tag or str(key[0]), SceneFile) if len(key) > 1 else SceneFile
        return f"{where}: the key {name} is unknown, wanted one of: {', '.join(_keys(model))}"
    if kind.startswith("union_tag"):
        kinds = [word.strip("' ") for word in fault["ctx"].get("expected_tags", "").split(",")] or ["kind"]
        came = fault["input"].get("kind") if isinstance(fault["input"], dict) else fault["input"]
        wanted = ", ".join(kinds) if kinds != [""] else "a kind"
        return f"{where}: {name}.kind is {shown(came)}, wanted one of: {wanted}"
    wanted = re.sub(r"^(Value error, )?(Input should )?(be )?", "", message).replace("1" + 30 * "0", "1e30")
    if kind in ("tuple_type", "list_type"):
        wanted = "a list"
    elif kind in ("too_short", "too_long"):
        wanted = " and ".join(f"{word} {fault['ctx'][word]} items" for word in LENGTHS if word in fault["ctx"])
        wanted = wanted.replace("min_length", "at least").replace("max_length", "at most")
    return f"{where}: {name} is {shown(fault['input'])}, wanted {wanted}"


def _without_tags(loc: Sequence[str | int], tables: Any) -> tuple[Key, str]:
    """The path of keys through the file itself, without the kinds that pydantic puts between, and the last of those."""
    key: list[str | int] = []
    tag, at = "", tables
    for step in loc:
        if isinstance(at, dict) and isinstance(step, str) and step not in at and at.get("kind") == step:
            tag = step
            continue
        key.append(step)
        try:
            at = at[step]
        except (KeyError, IndexError, TypeError):
            at = None
    return tuple(key), tag


def _keys(model: type[BaseModel]) -> list[str]:
    """The keys of a table as users write them."""
    names = []
    for name, field in model.model_fields.items():
        alias = field.validation_alias
        names.append(str(alias.choices[0]) if isinstance(alias, AliasChoices) else name)
    return names


def located(path: Path, text: str, key: Key) -> str:
    """The file, and the line of a key if it can be found, to begin a message with."""
    line = line_of(text, key)
    return f"{path}, line {line}" if line else str(path)


def shown_key(key: Key) -> str:
    """`surfaces[3].radius`"""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in key)
    return text.removeprefix(".")


def _named(name: str, is_list: bool, counts: dict[Key, int]) -> Key:
    """The path of a header: tables of a list are numbered, and within them their latest table is meant."""
    path: Key = ()
    parts = name.split(".")
    for depth, part in enumerate(parts, 1):
        path = (*path, part.strip(" \"'"))
        if is_list and depth == len(parts):
            counts[path] = counts.get(path, -1) + 1
        if path in counts:
            path = (*path, counts[path])
    return path


def line_of(text: str, key: Key) -> int | None:
    """The line on which a key, or the innermost table around it, stands; None if it cannot be found.

    Reads headers and assignments as they are usually written, one a line; what is inside inline tables or strings of
    several lines is attributed to where they begin.
    """
    lines: dict[Key, int] = {}
    counts: dict[Key, int] = {}
    table: Key = ()
    for number, line in enumerate(text.splitlines(), 1):
        line = line[:LONGEST_LINE]
        header, assignment = HEADER.match(line), ASSIGNMENT.match(line)
        if header and not assignment:
            table = _named(header[2], bool(header[1]), counts)
            lines.setdefault(table, number)
            lines.setdefault(table[:1], number)
        elif assignment:
            lines.setdefault((*table, assignment[1].strip('"')), number)
    for length in range(len(key), 0, -1):
        if key[:length] in lines:
            return lines[key[:length]]
    return None
