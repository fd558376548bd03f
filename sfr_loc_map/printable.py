"""Texts that may quote a stranger's file or name, made fit for a terminal and a log.

A file can hold anything: escape sequences that rename a window or overwrite lines, characters that turn the direction
of writing, halves of surrogate pairs that no encoding takes, megabytes in one word.
"""

from __future__ import annotations

import re

MAX_MESSAGE = 600
"""Characters of a message; the first and the last ones of a longer text are kept."""
_TAIL = 200
_UNPRINTABLE = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufeff]"
)
"""Controls (C0 without tab and line feed, DEL, C1), marks of direction, separators of lines, surrogates."""


def printable(text: str) -> str:
    r"""Return a text with unprintable characters written as in Python: ESC becomes `\x1b`."""
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def one_line(text: str) -> str:
    """Return a message as one printable line of bounded length; the middle of a longer one is left out."""
    line = printable(" ".join(text.split()))
    if len(line) <= MAX_MESSAGE:
        return line
    left_out = len(line) - MAX_MESSAGE
    return f"{line[: MAX_MESSAGE - _TAIL]} ... ({left_out} characters left out) ... {line[-_TAIL:]}"
