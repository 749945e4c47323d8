"""Reads TOML within limits of size and depth: the reader of the standard library makes a table for each part of a key, and more."""

from __future__ import annotations

import re
import tomllib

from raygrid.host.text.clean_text import printable, unreadable

LARGEST_TEXT = 1 << 26  # bytes: reading takes a minute by then
MOST_PARTS = 50  # of a key
# A run of words with dots between, quoted or not. Possessive, so that no run is looked through twice.
WORD = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
MORE = rf"(?:[ \t]*+\.[ \t]*+{WORD})"
RUN, DOTTED = re.compile(f"{WORD}{MORE}*+"), re.compile(f"{WORD}{MORE}{{{MOST_PARTS}}}")


def read_toml(data: bytes) -> tuple[str, dict[str, object]]:
    """Return the text and its tables. Raises ValueError, saying what is wrong."""
    if len(data) > LARGEST_TEXT:
        raise ValueError(f"it has {len(data):,} bytes, wanted at most {LARGEST_TEXT:,}")
    text = data.decode("utf-8")
    for run in RUN.finditer(text):
        if run.end() - run.start() > MOST_PARTS and DOTTED.match(text, run.start()):
            line = text.count("\n", 0, run.start()) + 1
            raise ValueError(f"line {line} has a key of more than {MOST_PARTS} parts")
    try:
        return text, tomllib.loads(text)
    except RecursionError:
        raise ValueError("its lists and tables lie too deep within each other") from None
    except ValueError as error:
        raise ValueError(printable(unreadable(error), 500)) from None
