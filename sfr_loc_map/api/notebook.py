"""Objects as a notebook shows them."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from sfr_loc_map.inputs import printable


def facts_html(title: str, facts: Mapping[str, str]) -> str:
    """Return a title and a table of names and values as HTML; every text is escaped."""
    rows = "".join(
        f"<tr><th style='text-align:left'>{_safe(name)}</th><td style='text-align:left'>{_safe(value)}</td></tr>"
        for name, value in facts.items()
    )
    return f"<b>{_safe(title)}</b><table>{rows}</table>"


def _safe(text: str) -> str:
    return escape(printable(text))
