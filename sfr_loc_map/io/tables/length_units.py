"""Units of lengths: their symbols, and their mention in a comment."""

from __future__ import annotations

import re

METRES = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0}
"""Units of lengths, m. The default unit is the metre."""
_PREFIXES = {"milli": "mm", "centi": "cm", "kilo": "km"}
_MENTION = re.compile(
    r"\[(mm|cm|km)\]|\((mm|cm|km)\)|\bin (mm|cm|km)\b|\bunits?\b(?: is| are)?\W+(mm|cm|km)\b|"
    r"\b(milli|centi|kilo)met(?:er|re)s?\b",
    re.IGNORECASE,
)


def unit_in_comment(text: str) -> str:
    """Return the unit of lengths, other than the metre, that a comment states; empty if it states none.

    Examples: `positions in mm`, `units: mm`, `all lengths [mm]`, `millimetres`.
    """
    found = _MENTION.search(text)
    if found is None:
        return ""
    word = next(str(group).lower() for group in found.groups() if group)
    return _PREFIXES.get(word, word)
