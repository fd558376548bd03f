"""The report page: a single HTML file made from the score, which requires no network and no other file."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from itertools import islice
from operator import itemgetter
from pathlib import Path, PurePath
from typing import Any, NamedTuple

from sfr_loc_map import __version__
from sfr_loc_map.atomic import write_text
from sfr_loc_map.config import flatten
from sfr_loc_map.metrics.catalogue import Subject
from sfr_loc_map.metrics.config import ScoreConfig, VerdictState, label_of
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.metrics.verdict import counts_of
from sfr_loc_map.report.plots import PALETTES, TEMPLATE, Plot
from sfr_loc_map.report.score_plots import error_sizes, path_of, plotted_conditions, score_plots
from sfr_loc_map.report.score_tables import EXACT, glossary, score_tables, truth_text
from sfr_loc_map.report.tables import METRE, OPEN, UNKNOWN, VERDICTS, Table, fitting, number, to_html
from sfr_loc_map.report.verdict_view import VerdictView, verdict_views

TITLE = "Localisation and mapping report"
FIRST_TABLES = ("verdicts", "pairs", "failures", "headline", "covered", "readings", "counts", "groups")
"""Tables before the figures."""
TRUTH_FILES, READ_ROLES = ("truth_file",), ("configuration", "calibration")
TRUTH_ROLES, RESULT_ROLES = ("truth", "map_truth"), ("estimate", "cloud")
NO_VERDICT, NO_VERDICT_ICON = "no verdict", "\u2013"
MOST_TO_LOOK_AT = 5  #: Maximum number of issues at the top of the page.
Sections = Sequence[tuple[str, list[Plot]]]


# ---- the page


def write_page(score: Score, path: Path) -> None:
    """Write the report page; an existing file is replaced."""
    write_text(render_page(score), path)


def render_page(score: Score, *, plots: bool = True) -> str:
    """Return the page as HTML. Without plots the page has only tables and no script, ready for print."""
    sections, tables = score_plots(score) if plots else [], [*score_tables(score), glossary()]
    provenance, name = _texts(to_plain(score.provenance) or {}), data_set_name(score)
    return _rendered(
        tables,
        sections,
        title=f"{name}: {TITLE[0].lower()}{TITLE[1:]}" if name else TITLE,
        facts=run_facts(score),
        look_first=look_first(score),
        version=provenance.get("version", UNKNOWN),
        time=provenance.get("time", "time unknown"),
        overall=overall_of(score),
        provenance=list(provenance.items()),
        every=path.every if (path := path_of(score)) is not None else 1,
    )


def render_overview(
    title: str, state: VerdictState | None, text: str, tables: Sequence[Table], sections: Sections, heading: str = ""
) -> str:
    """Return a page about many scores as HTML: overall verdict or heading, text, tables and plots."""
    return _rendered(
        tables,
        sections,
        title=title,
        version=__version__,
        time=datetime.now(UTC).isoformat(timespec="seconds"),
        overall=_overall(heading or state, text, NO_VERDICT_ICON),
        sortable=True,
    )


def render_tables(title: str, tables: Sequence[Table]) -> str:
    """Return a page of tables as HTML, without plots and scripts."""
    return render_overview(title, None, "", tables, (), heading="tables")


def _rendered(
    tables: Sequence[Table],
    sections: Sections,
    *,
    title: str,
    version: str,
    time: str,
    overall: Overall,
    facts: Sequence[tuple[str, str]] = (),
    look_first: Sequence[LookFirst] = (),
    provenance: Sequence[tuple[str, Any]] | None = None,
    every: int = 1,
    sortable: bool = False,
) -> str:
    """Return a page of tables and sections with plots, with the facts of the score for the template."""
    plots, plotly = [plot for _, group in sections for plot in group], ""
    if plots:
        from plotly.offline import get_plotlyjs

        plotly = base64.b64encode(gzip.compress(get_plotlyjs().encode(), 6, mtime=0)).decode()
    html: dict[bool, str] = {True: "", False: ""}
    for table in tables:
        html[table.name in FIRST_TABLES] += to_html(table)
    shown = {"first": html[True], "tables": html[False], "sections": sections}
    template = {**TEMPLATE, "palettes": PALETTES}
    return from_template(
        "page.html.j2",
        title=title,
        version=version,
        time=time,
        overall=overall,
        facts=facts,
        look_first=look_first,
        provenance=provenance,
        every=every,
        sortable=sortable,
        plotly=plotly,
        specs=plots,
        template=template,
        **shown,
    )


def from_template(name: str, **values: Any) -> str:  # noqa: ANN401 - of the template
    """Return the page of a template with all texts escaped."""
    from jinja2 import Environment, PackageLoader  # not needed by callers that only use the verdict

    loader = PackageLoader("sfr_loc_map", "report/templates")
    environment = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    plain = {"default": lambda item: {each.name: getattr(item, each.name) for each in fields(item)}}  # dataclasses
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":"), **plain}
    return environment.get_template(name).render(**values)


def _texts(values: Mapping[str, Any]) -> dict[str, str]:
    lists = {name: value if isinstance(value, list) else [value] for name, value in flatten(values).items()}
    return {name: ", ".join(UNKNOWN if item is None else str(item) for item in row) for name, row in lists.items()}


# ---- the banner: the verdict over all limits


@dataclass(frozen=True, slots=True)
class Overall:
    """The verdict over all limits: word, sentence, style sheet class and icon."""

    state: str
    text: str
    style: str
    icon: str


def _overall(state: str | None, text: str, open_icon: str) -> Overall:
    style = VERDICTS.get(state or NO_VERDICT, OPEN._replace(icon=open_icon))
    return Overall(str(state or NO_VERDICT), text, style.css, style.icon)


def overall_of(score: Score) -> Overall:
    """Return the displayed verdict over all limits."""
    state = score.verdict
    if score.contradiction is not None and not score.fatal_findings:
        return _overall(None, f"Not judged: {score.contradiction}", NO_VERDICT_ICON)
    part = "" if score.incomplete is None else f"Incomplete: {score.incomplete}. "
    if score.fatal_findings:
        part = f"The method under test failed: {', '.join(item.kind for item in score.fatal_findings)}. {part}"
    if not score.on_limits:
        text = part.strip() or "No limits were given: there is no verdict."
        return _overall(state, text, NO_VERDICT_ICON if state is None else OPEN.icon)
    text = f"{part}{counts_of(score.on_limits).text}."
    certain = [item.certain for item in score.verdicts if item.certain is not None]
    if certain:
        text += (
            f" For {sum(certain)} of {len(certain)} limits with a 95 % interval, the interval does not span the limit."
        )
    return _overall(state, text, OPEN.icon)


# ---- the header: data, duration, method, settings and time


def data_set_name(score: Score) -> str:
    """Return the name of the data set of the truth; empty if it is unknown."""
    for path in _paths(score, TRUTH_ROLES):
        place = PurePath(path)
        while place.name in ("groundtruth.csv", "loc", "nav") and place.parent.name:  # parts of a data set folder
            place = place.parent
        return place.name
    return ""


def run_facts(score: Score) -> tuple[tuple[str, str], ...]:
    """Return the facts of the header, each with its name; unknown facts are not shown."""
    drive, method, made = score.association, score.method, score.provenance
    truths = _paths(score, TRUTH_FILES) or _paths(score, TRUTH_ROLES)
    facts = {
        "Truth": ", ".join(truths),
        "Read as": ", ".join(_paths(score, READ_ROLES)),
        "Judged": ", ".join(_paths(score, RESULT_ROLES)),
    }
    if drive is not None:
        facts["Drive"] = f"{number(drive.path_length_m)} m in {number(drive.duration_s)} s, "
        facts["Drive"] += f"{drive.matched} stereo pairs with a truth"
    if score.cloud is not None:
        points, pairs = score.number("points"), score.number("pairs")
        facts["Map"] = f"{_count(points)} points of {_count(pairs)} stereo {'pair' if pairs == 1 else 'pairs'}"
    facts["Method"] = "not named in the inputs"
    if method is not None:
        facts["Method"] = f"{method.name} {method.version or 'of unknown version'} ({method.kind})"
    if score.convention is not None:
        facts["Poses converted"] = "yes, see Method under test"
    if made is not None:
        if made.configuration:  # settings of other parts are only present if they are changed
            usual, given = _texts(to_plain(flatten(ScoreConfig()))), _texts(to_plain(made.configuration))
            texts = (f"{name} {text}" for name, text in given.items() if usual.get(name) != text)
            facts["Configuration"] = "; ".join(texts) or "defaults"
        known = {name: made.host[name] for name in ("machine", "system", "python") if name in made.host}
        host = ", ".join(f"Python {value}" if name == "python" else value for name, value in known.items())
        by = f"by sfr_loc_map {made.version or UNKNOWN}{f' on {host}' if host else ''}"
        facts["Scored"] = f"{made.time or 'time unknown'} {by}"
    return tuple((name, text) for name, text in facts.items() if text)


def _count(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.0f}"


def _paths(score: Score, roles: Sequence[str]) -> list[str]:
    inputs = {} if score.provenance is None else score.provenance.inputs
    return list(dict.fromkeys(inputs[role].path for role in roles if role in inputs))


# ---- what to look at first: failures, or else the smallest margins, each with the reason


class LookFirst(NamedTuple):
    """One item to look at: a phrase for the item and a sentence for the reason."""

    what: str
    why: str


def look_first(score: Score) -> tuple[LookFirst, ...]:
    """Return the items to look at: failures, then the smallest margin and the worst sub-trajectory.

    A contradiction of estimate and truth and incomplete results are not repeated, because the verdict states them.
    """
    return tuple(islice(_worth_a_look(score), MOST_TO_LOOK_AT))


def _worth_a_look(score: Score) -> Iterator[LookFirst]:
    for finding in score.findings:
        yield LookFirst(str(finding.kind), f"Finding on the method under test: {finding}.")
    views = list(verdict_views(score))
    for view in sorted(views, key=_use_of, reverse=True):
        if view.item.state is VerdictState.FAIL:
            yield LookFirst(view.name, f"The limit is missed: {_beside_limit(view)}")
    part = score.association
    for count, word in () if part is None else ((part.lost, "lost"), (part.degraded, "degraded")):
        if count and part is not None:
            share = number(100.0 * count / max(part.matched, 1))
            why = (
                f"{count} of {part.matched} frames ({share} %) are {word}. They count in every figure like the others."
            )
            yield LookFirst(f"{word} frames", why)
    for view in views:
        if view.reason:
            yield LookFirst(view.name, f"There is not enough data to judge this limit: {view.reason}.")
    for row in score.rows("nees", subject=Subject.CONSISTENCY, part="pose"):
        if row.mean is not None and row.interval is not None and not row.interval[0] <= row.mean <= row.interval[1]:
            why = f"Over {label_of(row.condition)} the normalised squared error (NEES) is {number(row.mean)} "
            why += f"instead of {number(row.value)}. {truth_text(score) or EXACT}"
            size = "large" if row.mean < row.interval[0] else "small"
            yield LookFirst(f"the covariance of the odometry, which is too {size}", why.strip())
    met = [view for view in views if view.item.state is VerdictState.PASS]
    if met:
        nearest = max(met, key=_use_of)
        why = f"This limit is met with the smallest margin: {_beside_limit(nearest)}"
        yield LookFirst(nearest.name, why)
    for first in plotted_conditions(score)[:1]:
        rows = first.rows
        largest_m = score.number("position", "max", condition=rows.condition)
        if largest_m is not None:
            unit = fitting(METRE, largest_m)
            why = f"Over {first.over} the largest position error is {number(largest_m, unit=unit)} {unit.symbol}"
            sizes = [(size, row) for row, size in enumerate(error_sizes(rows)) if size is not None]
            if rows.every == 1 and sizes:  # thinned rows may lack the worst sub-trajectory
                worst = max(sizes, key=itemgetter(0))[1]
                why += f", at frames {rows.start_frame[worst]} to {rows.end_frame[worst]}"
            why += "."
            yield LookFirst("the worst sub-trajectory", why)


def _beside_limit(view: VerdictView) -> str:
    spans = view.item.certain is False
    doubt = " Its 95 % interval spans the limit: more data may change the verdict." if spans else ""
    return f"{view.comparison}.{doubt}"


def _use_of(view: VerdictView) -> float:
    return view.use or 0.0
