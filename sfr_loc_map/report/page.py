"""The report: one HTML file made from the score alone, that needs no network and no other file."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path

from jinja2 import Environment, PackageLoader, Template
from markupsafe import Markup

from sfr_loc_map import __version__
from sfr_loc_map.bounded_input import MAX_JSON_BYTES, read_text
from sfr_loc_map.errors import InputError
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import from_json, to_plain
from sfr_loc_map.report.cost_figures import cost_figures
from sfr_loc_map.report.error_figures import error_figures
from sfr_loc_map.report.look_first import LookFirst, look_first
from sfr_loc_map.report.map_figures import map_figures
from sfr_loc_map.report.overall import NO_VERDICT, NO_VERDICT_ICON, Overall, overall_of
from sfr_loc_map.report.plots import Plot
from sfr_loc_map.report.run_header import data_set_name, run_facts
from sfr_loc_map.report.score_tables import score_tables
from sfr_loc_map.report.trajectory_figures import trajectory_figures
from sfr_loc_map.tables.html import OPEN_CLASS, VERDICT_CLASSES, to_html
from sfr_loc_map.tables.numbers import UNKNOWN
from sfr_loc_map.tables.table import VERDICT_ICONS, Table

TITLE = "Localisation and mapping report"
FIRST_TABLES = ("verdicts", "headline")
"""Tables before the figures; they are the first of a score."""
_BREAKS_OUT = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"}


def load_score(path: Path) -> Score:
    """Read a score; numbers that are not finite are undefined.

    Raises:
        InputError: If the file cannot be read or holds no score.
    """
    try:
        text = read_text(path, MAX_JSON_BYTES)
    except OSError as error:
        raise InputError(f"cannot read score '{path}': {error.strerror}; give the JSON of sfr score --json") from error
    except ValueError as error:
        raise InputError(f"score '{path}' is not text ({error}): give the JSON of sfr score --json") from error
    return from_json(text, f"'{path}'")


def write_page(score: Score, path: Path) -> None:
    """Write the report page; an existing file is replaced.

    Raises:
        OutputError: If the file cannot be written.
    """
    text = render_page(score)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def render_page(score: Score, *, figures: bool = True) -> str:
    """Return the page as HTML.

    Args:
        score: The score.
        figures: Whether to draw figures; without them the page holds tables only and no script, ready for print.
    """
    sections = _sections(score) if figures else []
    plots = [plot for _, group in sections for plot in group]
    tables = score_tables(score)
    first = [table for table in tables if table.name in FIRST_TABLES]
    provenance = dict(_flat(to_plain(score.provenance) or {}, ""))
    details = score.details.trajectory if score.details is not None else None
    return _template("page.html.j2").render(
        title=f"{name}: {TITLE[0].lower()}{TITLE[1:]}" if (name := data_set_name(score)) else TITLE,
        facts=run_facts(score),
        look_first=_reachable(score, tables, sections),
        version=provenance.get("version", UNKNOWN),
        time=provenance.get("time", "time unknown"),
        overall=overall_of(score),
        first=_html(first),
        tables=_html(tables[len(first) :]),
        sections=sections,
        provenance=list(provenance.items()),
        plotly=_plotly() if plots else "",
        specs=_inline_json([asdict(plot) for plot in plots]),
        every=details.path.every if details is not None else 1,
    )


def _reachable(score: Score, tables: Sequence[Table], sections: Sequence[tuple[str, list[Plot]]]) -> list[LookFirst]:
    """Return what to look at first, each with a place that this page has."""
    places = {f"table-{table.name}" for table in tables}
    places |= {f"figure-{plot.name}" for _, group in sections for plot in group}
    everything = f"table-{tables[0].name}" if tables else "overall"
    return [item if item.place in places else replace(item, place=everything) for item in look_first(score)]


def render_overview(
    title: str,
    state: VerdictState | None,
    text: str,
    tables: Sequence[Table],
    sections: Sequence[tuple[str, list[Plot]]],
    heading: str = "",
) -> str:
    """Return a page about many scores as HTML, laid out as that of one.

    Args:
        title: Its title.
        state: Verdict over all, None without limits.
        text: What the banner says beside it.
        tables: Its tables; those named `verdicts`, `counts` and `groups` come before the figures.
        sections: Figures by heading.
        heading: Heading of the banner instead of the verdict, for what is not judged.
    """
    plots = [plot for _, group in sections for plot in group]
    first = [table for table in tables if table.name in ("verdicts", "counts", "groups")]
    word = heading or (NO_VERDICT if state is None else state.value)
    return _template("page.html.j2").render(
        title=title,
        version=__version__,
        time=datetime.now(UTC).isoformat(timespec="seconds"),
        overall=Overall(word, text, VERDICT_CLASSES.get(word, OPEN_CLASS), VERDICT_ICONS.get(word, NO_VERDICT_ICON)),
        first=_html(first),
        tables=_html(table for table in tables if table not in first),
        sections=sections,
        provenance=None,
        plotly=_plotly() if plots else "",
        specs=_inline_json([asdict(plot) for plot in plots]),
        every=1,
    )


def render_tables(title: str, tables: Sequence[Table]) -> str:
    """Return a page of tables, without figures, script or network, as HTML."""
    return _template("tables.html.j2").render(title=title, tables=_html(tables))


def _template(name: str) -> Template:
    loader = PackageLoader("sfr_loc_map", "report/templates")
    return Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True).get_template(name)


def _html(tables: Iterable[Table]) -> Markup:
    """Return tables as HTML; their renderer escapes every text."""
    return Markup("".join(map(to_html, tables)))


def _sections(score: Score) -> list[tuple[str, list[Plot]]]:
    groups = (
        ("Localisation", trajectory_figures(score) + error_figures(score)),
        ("Time and memory", cost_figures(score)),
        ("Map", map_figures(score)),
    )
    return [(title, plots) for title, plots in groups if plots]


def figures_of(score: Score) -> list[Plot]:
    """Return the figures of the page, in its order."""
    return [plot for _, plots in _sections(score) for plot in plots]


def _flat(value: object, prefix: str) -> Iterator[tuple[str, str]]:
    """Yield name and text of each entry of nested JSON values."""
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
