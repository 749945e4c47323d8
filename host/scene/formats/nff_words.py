"""Splits an NFF file into words, converts numbers in bulk, and assigns them to their keywords.

The format is a sequence of blank-separated words. A keyword is any word that begins with a letter (or a character above
them); what follows it, up to the next, must be numbers. So one pass finds the keywords, one converts all numbers, and
everything after that works on whole columns: 130,000 polygons take no step of Python a number.

Lines are counted only for messages, by splitting once more.
"""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.polygons import Ints
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64

COMMENT = re.compile(rb"#[^\r\n]*")
WORD = re.compile(rb"[^ \t\n\r\x0b\x0c]+")  # what bytes.split() takes for a word

# What each keyword is called in messages, and how many numbers follow it. Polygons say it themselves, lights vary.
GRAMMAR: dict[str, tuple[str, int | None]] = {
    "b": ("background", 3),
    "v": ("viewpoint", 0),
    "from": ("eye position", 3),
    "at": ("point looked at", 3),
    "up": ("up direction", 3),
    "angle": ("view angle", 1),
    "hither": ("hither distance", 1),
    "resolution": ("resolution", 2),
    "l": ("light", None),
    "f": ("fill", 8),
    "c": ("cone or cylinder", 8),
    "s": ("sphere", 4),
    "p": ("polygon", None),
    "pp": ("polygon with normals", None),
}
CODES = {keyword.encode(): code for code, keyword in enumerate(GRAMMAR)}
NAMES = tuple(GRAMMAR)


class Words:
    """The entities of one file: entity k has the keyword `NAMES[codes[k]]` and the numbers
    `numbers[begins[k]]` to `numbers[begins[k] + counts[k]]`.

    Raises SceneError for a word that is neither keyword nor finite number, and for numbers before the first keyword.
    """

    codes: NDArray[np.int8]
    begins: Ints
    counts: Ints
    numbers: F64

    def __init__(self, path: Path, text: bytes) -> None:
        self.path = path
        # Comments become nothing, but their line ends stay, so that lines can still be counted.
        self._text = COMMENT.sub(b"", text.removeprefix(b"\xef\xbb\xbf"))
        words = self._text.split()
        marks = [k for k, word in enumerate(words) if word[0] > 64]  # letters come after all that begins a number
        if not words:
            raise SceneError(f"{path}: the file is empty, wanted a viewpoint and surfaces")
        if not marks or marks[0] != 0:
            raise self.error_at(0, f"came {_shown(words[0])} before any keyword, wanted one of {_keywords()}")
        self.codes = self._codes([words[k] for k in marks], marks)
        for k in marks:
            words[k] = b"0"
        self.numbers = self._converted(words)
        self.begins = np.array(marks, np.int64) + 1
        self.counts = np.diff(self.begins, append=len(words) + 1) - 1

    def of(self, keyword: str) -> Ints:
        """The entities with this keyword, ascending."""
        return np.flatnonzero(self.codes == CODES[keyword.encode()])

    def columns(self, entities: Ints, count: int, skip: int = 0) -> F64:
        """The first `count` numbers after `skip` of each entity, (n, count)."""
        chosen: F64 = self.numbers[self.begins[entities, None] + skip + np.arange(count)]
        return chosen

    def rows(self, entities: Ints, sizes: Ints, width: int) -> tuple[F64, Ints]:
        """The numbers after an entity's first, as rows of `width`: (sum of sizes, width), and where each begins."""
        starts = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        inside = np.arange(starts[-1]) - np.repeat(starts[:-1], sizes)
        first = np.repeat(self.begins[entities] + 1, sizes) + width * inside
        return self.numbers[first[:, None] + np.arange(width)], starts

    def error(self, entity: int, message: str) -> SceneError:
        """An error about an entity, with the line of its keyword."""
        return self.error_at(int(self.begins[entity]) - 1, message)

    def error_at(self, word: int, message: str) -> SceneError:
        """An error about the word of that number, with its line."""
        match = next(islice(WORD.finditer(self._text), word, None))
        before = self._text[: match.start()]
        line = 1 + (before.count(b"\n") if b"\n" in self._text else before.count(b"\r"))
        return SceneError(f"{self.path}, line {line}: {message}")

    def _codes(self, keywords: list[bytes], marks: list[int]) -> NDArray[np.int8]:
        try:
            return np.fromiter((CODES[word] for word in keywords), np.int8, len(keywords))
        except KeyError:
            k = next(k for k, word in enumerate(keywords) if word not in CODES)
            shown = _shown(keywords[k])
            if _is_number(keywords[k]):  # nan and inf look like words
                raise self.error_at(marks[k], f"came {shown}, wanted a finite number") from None
            raise self.error_at(marks[k], f"came the unknown word {shown}, wanted one of {_keywords()}") from None

    def _converted(self, words: list[bytes]) -> F64:
        try:
            numbers = np.fromiter(map(float, words), np.float64, len(words))
        except ValueError:
            k = next(k for k, word in enumerate(words) if not _is_number(word))
            raise self.error_at(k, f"came {_shown(words[k])}, wanted a number") from None
        finite = np.isfinite(numbers)
        if not finite.all():
            k = int(np.argmin(finite))
            raise self.error_at(k, f"came {_shown(words[k])}, wanted a finite number")
        if b"_" in self._text:  # Python reads 1_000 as a number, NFF does not
            for k, word in enumerate(words):
                if b"_" in word:
                    raise self.error_at(k, f"came {_shown(word)}, wanted a number")
        return numbers


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _keywords() -> str:
    return " ".join(NAMES)


def _shown(word: bytes) -> str:
    text = word.decode("ascii", "backslashreplace")
    return repr(text if len(text) <= 40 else text[:37] + "...")
