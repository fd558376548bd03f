"""Messages are one printable line of bounded length, whatever they quote."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.printable import MAX_MESSAGE, one_line, printable

anything = st.text(st.characters(exclude_categories=()), max_size=80)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain, with \u00e4 and \u2714", "plain, with \u00e4 and \u2714"),
        ("\x1b]0;title\x07", r"\x1b]0;title\x07"),
        ("\x9b31m\0\x7f", r"\x9b31m\x00\x7f"),
        ("\u202eabc\ud800\udc80", r"\u202eabc\ud800\udc80"),
        ("two\nlines\tand a tab", "two\nlines\tand a tab"),
    ],
)
def test_controls_are_written_as_in_python(text: str, shown: str) -> None:
    assert printable(text) == shown


@given(anything)
def test_a_message_is_one_line_that_every_terminal_bears(text: str) -> None:
    line = one_line(text)
    assert line.isprintable() or not re.search(r"[\x00-\x1f\x7f-\x9f]", line)
    line.encode("utf-8")


def test_the_middle_of_a_long_message_is_left_out() -> None:
    line = one_line("cannot read " + "x" * 10_000_000 + "; restore it")
    assert line.startswith("cannot read xxx")
    assert line.endswith("xxx; restore it")
    assert len(line) < MAX_MESSAGE + 50
    assert "characters left out" in line
