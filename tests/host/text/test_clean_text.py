"""Text out of files: what of it may be shown, and that nothing else ever is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raygrid.host.text.clean_text import GAP, SHOWN, printable, shown
from raygrid.host.text.tables import folded

ANYTHING = st.text(st.characters(codec=None), max_size=80)  # lone surrogates, too


@pytest.mark.parametrize(
    ("came", "shown"),
    [
        ("room.glb", "room.glb"),
        ("Türgriff \N{SNOWMAN} 門", "Türgriff \N{SNOWMAN} 門"),
        ("a\x1b]0;owned\x07b", "a\\x1b]0;owned\\x07b"),
        ("\x9b31m", "\\x9b31m"),
        ("one\nraygrid: two\r", "one\\nraygrid: two\\r"),
        ("\N{RIGHT-TO-LEFT OVERRIDE}gnp.txt", "\\u202egnp.txt"),
        (b"T\xfcr.png".decode("utf-8", "surrogateescape"), "T\\xfcr.png"),
        ("\ud800", "\\ud800"),
        ("\U000e0001", "\\U000e0001"),
        ("", ""),
    ],
)
def test_control_characters_and_halves_of_characters_become_escapes(came: str, shown: str) -> None:
    assert printable(came) == shown


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.5, "1.5"),
        ("a\nb", r"'a\nb'"),
        (10**200, "a whole number of 665 bits"),
        ([10**5000], "a list"),
        (np.zeros((2, 1)), "array([[0.], [0.]])"),
    ],
)
def test_values_are_written_as_python_has_them_on_one_line(value: object, text: str) -> None:
    assert shown(value) == text


def test_of_a_long_value_the_beginning_and_the_end_are_written() -> None:
    text = shown("/" + 200 * "x" + "/room.glb")
    assert text.startswith("'/x")
    assert text.endswith("x/room.glb'")
    assert len(text) == SHOWN + 3


@given(ANYTHING, st.integers(0, 40))
def test_whatever_comes_can_be_shown_encoded_and_is_no_longer_than_asked_for(text: str, limit: int) -> None:
    shown = printable(text, limit)
    shown.encode("utf-8")
    assert len(shown) <= limit
    assert not any(ord(c) < 32 or 127 <= ord(c) < 160 for c in shown)
    assert printable(shown, limit) == shown


def test_what_is_too_long_is_cut_in_its_middle() -> None:
    shown = printable("/a/" + "b" * 9_000_000 + ": it is cut", 60)
    assert len(shown) == 60
    assert shown.startswith("/a/b")
    assert shown.endswith(": it is cut")
    assert GAP in shown


def test_lines_are_folded_at_words_for_a_terminal_and_paths_stay_whole():
    path = "/a/" + "b" * 90
    text = folded(f"short\n  one two-three {'x' * 70} four {path}", 80)
    assert text.split("\n") == ["short", "  one two-three", f"    {'x' * 70} four", path.rjust(len(path) + 4)]
