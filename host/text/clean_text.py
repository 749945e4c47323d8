"""Escapes and shortens text out of files, so that it can be shown in a terminal, a message, a journal.

What a scene says may hold anything: sequences that drive a terminal, marks that turn the direction of writing, line ends
that forge a second message, and halves of characters (from bytes that are no UTF-8, or from JSON's \\ud800) that no file
and no terminal takes. Whatever goes from a file into a message goes through here.
"""

from __future__ import annotations

import unicodedata

LONGEST = 2000  # of a whole sentence
GAP = " ... "
SHOWN = 60  # characters of a value that is named in an error
LONGEST_NUMBER = 512  # bits: thousands of digits take long to write, or are refused
BYTES = range(0xDC80, 0xDD00)  # how Python keeps bytes in a name that are no UTF-8


def printable(text: str, limit: int = LONGEST) -> str:
    """Return the text with all that is no visible character or plain space written as an escape, and at most `limit` long.

    What is longer is cut in its middle: of a path and of a message the end says as much as the beginning.
    """
    text = _cut(text, limit)
    return text if text.isascii() and text.isprintable() else _cut("".join(map(_escaped, text)), limit)


def shown(value: object) -> str:
    """Write a value as an error names it: as Python writes it, on one line, made short."""
    if type(value) is int and value.bit_length() > LONGEST_NUMBER:
        return f"a whole number of {value.bit_length()} bits"
    try:
        text = repr(value)
    except ValueError:  # such a number within
        return f"a {type(value).__name__}"
    if "\n" in text:  # rows of an array
        text = " ".join(text.split())
    if len(text) > SHOWN:  # of a path the end counts more
        text = f"{text[: SHOWN // 3]}...{text[-SHOWN * 2 // 3 :]}"
    return text


def _cut(text: str, limit: int) -> str:
    if len(text) <= limit:
        return text
    if limit <= 2 * len(GAP):
        return text[: max(limit, 0)]
    end = (limit - len(GAP)) // 3
    return text[: limit - len(GAP) - end] + GAP + text[len(text) - end :]


def unreadable(error: Exception) -> str:
    """Tell what a reader of TOML or JSON refused; Python's own words on long numbers advise programmers."""
    return "a number in it has too many digits" if type(error) is ValueError else str(error)


def _escaped(character: str) -> str:
    if character.isprintable() or unicodedata.category(character) == "Zs":
        return character
    number = ord(character)
    if number in BYTES:
        return f"\\x{number - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")
