"""The styles of verdicts in all views, by the word of the verdict."""

from __future__ import annotations

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.tables.model import Cell, VerdictStyle

STYLES = {
    VerdictState.PASS.value: VerdictStyle("✔", "pass", "green"),
    VerdictState.FAIL.value: VerdictStyle("✖", "fail", "bold red"),
}
OPEN = VerdictStyle("?", "open", "yellow")  #: Style of every other word.


def style_of(word: str) -> VerdictStyle:
    """Return the style of a verdict."""
    return STYLES.get(word, OPEN)


def verdict_cell(word: str, key: str = "") -> Cell:
    """Return the cell of a verdict with its style."""
    return Cell.verdict(word, style_of(word), key)
