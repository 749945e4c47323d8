"""Writes the tables of a scene file as TOML: all digits, one table after the other."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(document: Mapping[str, Any]) -> str:
    """The text of a document: single values, then [tables], tables by name, and [[lists of tables]]."""
    return "\n".join([*_lines(document), ""]).lstrip("\n")


def _lines(document: Mapping[str, Any]) -> Iterator[str]:
    for name, value in document.items():
        if not _is_table(value) and not _is_list_of_tables(value):
            yield f"{name} = {_value(value)}"
    for name, value in document.items():
        if _is_list_of_tables(value):
            for row in value:
                yield from ("", f"[[{name}]]", *_assignments(row))
        elif _is_table(value) and value and all(map(_is_table, value.values())):
            for key, row in value.items():
                yield from ("", f"[{name}.{_key(key)}]", *_assignments(row))
        elif _is_table(value):
            yield from ("", f"[{name}]", *_assignments(value))


def _assignments(table: Mapping[str, Any]) -> Iterator[str]:
    return (f"{_key(key)} = {_value(value)}" for key, value in table.items())


def _is_table(value: object) -> bool:
    return isinstance(value, Mapping)


def _is_list_of_tables(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(map(_is_table, value))


def _key(name: str) -> str:
    return name if BARE.fullmatch(name) else _text(name)


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_assignments(value)) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return repr(value)
