"""Texts from outside in messages: printable, in one line, of bounded length."""

from __future__ import annotations

import re
from collections.abc import Iterable

MAX_MESSAGE = 600  #: Maximum length of a message, characters. The middle of a longer text is omitted.
_TAIL = 200
_NUMBER = re.compile(r"(?<![\w/])-?[0-9]+(?:\.[0-9]+)?(?:e[-+]?[0-9]+)?")  # not the number in a name like /cam0
_UNPRINTABLE = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufeff\ufffe\uffff]"
)
"""Control characters (C0 without tab and line feed, DEL, C1), direction marks, line separators, surrogates, byte order
marks and noncharacters."""


def printable(text: str) -> str:
    r"""Return a text with unprintable characters written as in Python: ESC becomes `\x1b`.

    A file can contain escape sequences that rename a window or overwrite lines, characters that change the direction of
    writing, and halves of surrogate pairs, which cannot be encoded.
    """
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def alternatives(names: Iterable[str]) -> str:
    """Return names as in `a, b or c`."""
    *others, last = [*names] or [""]
    return f"{', '.join(others)} or {last}" if others else last


def counted(count: int, noun: str) -> str:
    """Return a number of things, as in `1 pair` or `2 pairs`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def kind_of(text: str) -> str:
    """Return a message without its numbers: the same for messages of one kind about different stamps or values."""
    return _NUMBER.sub("", text)


def one_line(text: str) -> str:
    """Return a message as one printable line of bounded length. The middle of a longer message is omitted."""
    line = printable(" ".join(text.split()))
    if len(line) <= MAX_MESSAGE:
        return line
    left_out = len(line) - MAX_MESSAGE
    return f"{line[: MAX_MESSAGE - _TAIL]} ... ({left_out} characters omitted) ... {line[-_TAIL:]}"
