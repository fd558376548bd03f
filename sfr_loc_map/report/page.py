"""The report page: a single HTML file made from the score, which requires no network and no other file.

`Page` contains the content of a page in the order in which the template `page.html.j2` shows it.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sfr_loc_map import __version__
from sfr_loc_map.atomic import write_text
from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.call_plots import timeline
from sfr_loc_map.report.drive_plots import drive_plots
from sfr_loc_map.report.glossary import glossary
from sfr_loc_map.report.map_plots import map_plots
from sfr_loc_map.report.plots import PALETTES, TEMPLATE, Plot
from sfr_loc_map.report.plotted_data import path_of
from sfr_loc_map.report.score_tables import page_tables
from sfr_loc_map.report.summary import (
    Banner,
    LookFirst,
    banner_of,
    data_set_name,
    look_first,
    provenance_texts,
    restrictions_of,
    run_facts,
)
from sfr_loc_map.tables.formats import to_html
from sfr_loc_map.tables.model import Table

if TYPE_CHECKING:  # slow import
    from jinja2 import Environment

TITLE = "Localisation and mapping report"
Sections = Sequence[tuple[str, list[Plot]]]
"""Plots with the heading of their section."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """The content of a page, in the order of the page. To add a part, add a field, its value and its place in HTML."""

    title: str
    made: str = ""  #: Time and version below the title; empty for a score, whose header has both.
    facts: Sequence[tuple[str, str]] = ()  #: Header of a score: names and texts.
    banner: Banner
    look_first: Sequence[LookFirst] = ()
    warnings: Sequence[str] = ()  #: What restricts the meaning of the figures.
    first_tables: Sequence[Table] = ()
    sections: Sections = ()
    tables: Sequence[Table] = ()
    provenance: Sequence[tuple[str, str]] | None = None  #: Keys and texts; None for a page without this section.
    every: int = 1  #: The plots show every n-th frame of the path.
    is_sortable: bool = False  #: Whether a click on a heading sorts a table.


class PlotData(NamedTuple):
    """What the script of a page draws."""

    plots: Sequence[Plot]
    template: dict[str, Any]  #: Common settings and the palettes.
    plotly: str  #: The library, gzip and base64.


def write_page(score: Score, path: Path) -> None:
    """Write the report page; an existing file is replaced."""
    write_text(render_page(score), path)


def render_page(score: Score, *, plots: bool = True) -> str:
    """Return the page as HTML. Without plots the page has only tables and no script, ready for print."""
    name, path = data_set_name(score), path_of(score)
    above, below = page_tables(score)
    page = Page(
        title=f"{name}: {TITLE[0].lower()}{TITLE[1:]}" if name else TITLE,
        facts=run_facts(score),
        banner=banner_of(score),
        look_first=look_first(score),
        warnings=restrictions_of(score),
        first_tables=above,
        sections=score_plots(score) if plots else (),
        tables=[*below, glossary()],
        provenance=list(provenance_texts(score).items()),
        every=1 if path is None else path.every,
    )
    return render(page)


def score_plots(score: Score) -> list[tuple[str, list[Plot]]]:
    """Return the plots by heading for which the score has data."""
    groups = (
        ("Localisation", drive_plots(score)),
        ("Time and memory", [plot for kind in CallKind for plot in timeline(score, kind)]),
        ("Map", map_plots(score)),
    )
    return [(title, plots) for title, plots in groups if plots]


def render_overview(
    title: str, banner: Banner, tables: Sequence[Table], sections: Sections = (), first: Collection[str] = ()
) -> str:
    """Return a page about many scores as HTML; `first` names the tables above the plots."""
    first_tables, others = parted(tables, first)
    page = Page(
        title=title,
        made=f"{datetime.now(UTC).isoformat(timespec='seconds')} \u00b7 sfr_loc_map {__version__}",
        banner=banner,
        first_tables=first_tables,
        sections=sections,
        tables=others,
        is_sortable=True,
    )
    return render(page)


def parted(tables: Sequence[Table], first: Collection[str]) -> tuple[list[Table], list[Table]]:
    """Return the tables above and below the plots of a page, each in the given order."""
    return [table for table in tables if table.name in first], [table for table in tables if table.name not in first]


def render(page: Page) -> str:
    """Return a page as HTML."""
    plots = [plot for _, group in page.sections for plot in group]
    data = None
    if plots:
        data = PlotData(plots, {**TEMPLATE, "palettes": PALETTES}, _packed_plotly())
    return from_template("page.html.j2", page=page, data=data)


@cache
def _packed_plotly() -> str:
    """Return the library plotly as gzip in base64, packed once for all pages of a process."""
    from plotly.offline import get_plotlyjs  # slow import

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 6, mtime=0)).decode()


def from_template(name: str, **values: Any) -> str:  # noqa: ANN401 - of the template
    """Return the page of a template with all texts printable and escaped; the filter `table` writes a table."""
    return _environment().get_template(name).render(**values)


def _printable_text(value: object) -> object:
    """Return a value of a template; texts, except finished HTML, become printable."""
    return printable(value) if type(value) is str else value


@cache
def _environment() -> Environment:
    """Return the environment of the templates, which keeps each template after it was compiled."""
    from jinja2 import Environment, PackageLoader  # not needed by callers that only use the verdict
    from markupsafe import Markup

    loader = PackageLoader("sfr_loc_map", "report/templates")
    environment = Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, finalize=_printable_text
    )
    environment.globals["palettes"] = PALETTES
    environment.filters["table"] = lambda table: Markup(to_html(table))
    plain = {"default": lambda item: {each.name: getattr(item, each.name) for each in fields(item)}}  # dataclasses
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":"), **plain}
    return environment
