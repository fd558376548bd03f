"""The report: one HTML file made from the score alone, that needs no network and no other file."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.metrics.results import SCHEMA, without_nan
from sfr_loc_map.report.cells import UNKNOWN, VERDICT_ICONS, dig
from sfr_loc_map.report.cost_figures import cost_figures
from sfr_loc_map.report.error_figures import error_figures
from sfr_loc_map.report.map_figures import map_figures
from sfr_loc_map.report.plots import Plot
from sfr_loc_map.report.score_tables import score_tables
from sfr_loc_map.report.trajectory_figures import trajectory_figures

VERDICT_CLASSES = {"pass": "pass", "fail": "fail"}
_BREAKS_OUT = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"}


def load_score(path: Path) -> dict[str, Any]:
    """Read a score; numbers that are not finite become None.

    Raises:
        InputError: If the file cannot be read or holds no score.
    """
    try:
        score = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read score '{path}': {error.strerror}; give the JSON of sfr score --json") from error
    except ValueError as error:
        raise InputError(f"score '{path}' is no JSON ({error}): give the JSON of sfr score --json") from error
    found = score.get("schema") if isinstance(score, dict) else type(score).__name__
    if found != SCHEMA:
        raise InputError(
            f"'{path}' is no score: sought schema {SCHEMA}, found {found}; give the JSON of sfr score --json"
        )
    plain: dict[str, Any] = without_nan(score)
    return plain


def write_page(score: Mapping[str, Any], path: Path) -> None:
    """Write the report page.

    Args:
        score: Score as in the JSON.
        path: Where; an existing file is replaced.

    Raises:
        InputError: If the score is not as its schema says.
        OutputError: If the file cannot be written.
    """
    text = render_page(score)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def render_page(score: Mapping[str, Any], *, figures: bool = True) -> str:
    """Return the page as HTML.

    Args:
        score: Score as in the JSON.
        figures: Whether to draw figures; without them the page holds tables only and no script, ready for print.

    Raises:
        InputError: If the score is not as its schema says.
    """
    try:
        return _render(without_nan(score), figures)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        problem = f"{type(error).__name__}: {error}"
        raise InputError(f"the score is not as {SCHEMA} says ({problem}): give the JSON of sfr score --json") from error


def _render(score: Mapping[str, Any], figures: bool) -> str:
    environment = Environment(
        loader=PackageLoader("sfr_loc_map", "report/templates"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    sections = _sections(score) if figures else []
    plots = [plot for _, group in sections for plot in group]
    tables = {table.name: table for table in score_tables(score)}
    return environment.get_template("page.html.j2").render(
        score=score,
        overall=_overall(score),
        first=[tables.pop(name) for name in ("verdicts", "headline") if name in tables],
        tables=list(tables.values()),
        sections=sections,
        provenance=_provenance_table(score),
        icons=VERDICT_ICONS,
        classes=VERDICT_CLASSES,
        plotly=_plotly() if plots else "",
        specs=_inline_json([asdict(plot) for plot in plots]),
        every=dig(score, "details.trajectory.path.every") or 1,
    )


def _sections(score: Mapping[str, Any]) -> list[tuple[str, list[Plot]]]:
    groups = (
        ("Localisation", trajectory_figures(score) + error_figures(score)),
        ("Time and memory", cost_figures(score)),
        ("Map", map_figures(score)),
    )
    return [(title, plots) for title, plots in groups if plots]


def _overall(score: Mapping[str, Any]) -> tuple[str, str]:
    """Return the verdict over all limits, and the same in a sentence."""
    words = [item.get("verdict") for item in score.get("verdicts") or []]
    if not words:
        return "none", "No limits were given: there is no verdict."
    counts = {word: words.count(word) for word in ("pass", "fail")}
    rest = len(words) - sum(counts.values())
    text = f"{counts['pass']} of {len(words)} limits met, {counts['fail']} missed, {rest} without enough data."
    if counts["fail"]:
        return "fail", text
    return ("not enough data", text) if rest else ("pass", text)


def _provenance_table(score: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(key, text) for key, text in _flat(score.get("provenance") or {}, "")]


def _flat(value: Any, prefix: str) -> Iterator[tuple[str, str]]:  # noqa: ANN401 - any value of JSON
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flat(item, f"{prefix}.{key}" if prefix else str(key))
    elif isinstance(value, list):
        yield prefix, ", ".join(UNKNOWN if item is None else str(item) for item in value)
    else:
        yield prefix, UNKNOWN if value is None else str(value)


def _plotly() -> str:
    """Return the script of plotly, compressed (the page would be 3 MB larger), as base64."""
    from plotly.offline import get_plotlyjs

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()


def _inline_json(value: object) -> Markup:
    """Return JSON that cannot end the script element it stands in."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    for sign, escape in _BREAKS_OUT.items():
        text = text.replace(sign, escape)
    return Markup(text)
