"""Units of lengths: their symbols, and their mention in a comment or in the title of a column."""

from __future__ import annotations

import re

METRES = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0}
"""Units of lengths that are converted, m. The default unit is the metre."""
LENGTH_NAMES = {
    "m": ("metre", "metres", "meter", "meters"),
    "cm": ("centimetre", "centimetres", "centimeter", "centimeters"),
    "mm": ("millimetre", "millimetres", "millimeter", "millimeters"),
    "km": ("kilometre", "kilometres", "kilometer", "kilometers"),
    "dm": ("decimetre", "decimetres", "decimeter", "decimeters"),
    "um": ("\u00b5m", "\u03bcm", "micron", "microns", "micrometre", "micrometres", "micrometer", "micrometers"),
    "nm": ("nanometre", "nanometres", "nanometer", "nanometers"),
    "ft": ("foot", "feet"),
    "inch": ("inches",),
    "yd": ("yard", "yards"),
    "mi": ("mile", "miles"),
}
"""Names of the units of lengths by their symbols. A unit that is not in `METRES` is refused."""
LENGTH_WORDS = tuple(word for symbol, names in LENGTH_NAMES.items() for word in (symbol, *names))
_SYMBOLS = {word: symbol for symbol, names in LENGTH_NAMES.items() for word in (symbol, *names)} | {"in": "inch"}
_OTHERS = [word for word, symbol in _SYMBOLS.items() if symbol != "m" and word != "in"]
_UNIT = "|".join(sorted(_OTHERS, key=len, reverse=True))
_PREFIXED = "|".join(word for word in _OTHERS if re.search("met(?:re|er)|micron", word))
_MENTION = re.compile(
    rf"[\[(]\s*({_UNIT}|in)\s*[\])]|\bin\s+({_UNIT})\b|"
    rf"(?<![a-z])units?\b(?:\s+(?:is|are))?[^\w\[(]+({_UNIT}|in)\b|[:=]\s*({_UNIT})\b|\b({_PREFIXED})\b",
    re.IGNORECASE,
)


def length_symbol(word: str) -> str:
    """Return the symbol of a unit of lengths: `mm` for `millimetres`; empty for another word."""
    return _SYMBOLS.get(word.strip().lower(), "")


def unit_in_comment(text: str) -> str:
    """Return the symbol of the first unit of lengths, other than the metre, in a comment; empty without such a unit.

    A unit is in brackets, or follows `in`, `unit`, a colon or an equals sign; names with a prefix, such as millimetres,
    are found anywhere. Examples: `positions in feet`, `length_unit=mm`, `all lengths [mm]`, `Translation: mm`.
    """
    mention = _MENTION.search(text)
    if mention is None:
        return ""
    return length_symbol(next(group for group in mention.groups() if group))
