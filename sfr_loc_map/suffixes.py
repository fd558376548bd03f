"""Suffixes of file names, which state a format. Upper and lower case have the same meaning."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import PurePath

from sfr_loc_map.errors import OutputError
from sfr_loc_map.message_text import alternatives


def suffix_of(path: PurePath) -> str:
    """Return the suffix of a name in lower case, such as `.csv`; empty for a name without a suffix."""
    return path.suffix.lower()


def check_suffix(path: PurePath, suffixes: Collection[str]) -> None:
    """Raise OutputError if the name of an output does not end in one of the suffixes, which are in lower case."""
    if suffix_of(path) not in suffixes:
        raise OutputError(f"cannot write '{path}': a name that ends in {alternatives(suffixes)} is required")
