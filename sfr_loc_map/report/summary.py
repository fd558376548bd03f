"""Summary of a score: the verdict over all limits, facts of the header, restrictions, and what to look at first.

Pages, the test report, the live page and the last lines of a command show these texts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from operator import itemgetter
from pathlib import PurePath
from typing import NamedTuple

from sfr_loc_map.configuration.parameters import flatten
from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.row_part import POSE
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.score.caveats import caveats_of
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import counts_of
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.report.notes import EXACT, truth_text
from sfr_loc_map.report.plotted_data import error_sizes, plotted_conditions
from sfr_loc_map.report.settings import changed_settings, has_all_settings, setting_text
from sfr_loc_map.report.verdict_view import OPEN, VerdictView, style_of, verdict_views
from sfr_loc_map.tables.model import METRE, UNKNOWN, fitting, number

TRUTH_FILES, READ_ROLES = ("truth_file",), ("configuration", "calibration")
TRUTH_ROLES, RESULT_ROLES = ("truth", "map_truth"), ("estimate", "cloud")
NO_VERDICT, NO_VERDICT_ICON = "no verdict", "\u2013"
MOST_TO_LOOK_AT = 5  #: Maximum number of items to look at.


# ---- the banner: the verdict over all limits


@dataclass(frozen=True, slots=True)
class Banner:
    """The banner of a page: word, sentences, style sheet class and icon."""

    state: str
    text: str
    style: str
    icon: str

    @classmethod
    def of(cls, state: VerdictState | None, text: str) -> Banner:
        """Return the banner of a verdict; None if there is no verdict."""
        if state is None:
            return cls.without_verdict(NO_VERDICT, text)
        style = style_of(state.value)
        return cls(state.value, text, style.css, style.icon)

    @classmethod
    def without_verdict(cls, heading: str, text: str) -> Banner:
        """Return the banner of a page that has no verdict."""
        return cls(heading, text, OPEN.css, NO_VERDICT_ICON)


def banner_of(score: Score) -> Banner:
    """Return the banner with the verdict of a score."""
    return Banner.of(score.verdict, _banner_text(score))


def _banner_text(score: Score) -> str:
    sentences = []
    if score.fatal_findings:
        sentences.append(f"The method under test failed: {', '.join(item.kind for item in score.fatal_findings)}.")
    if score.contradiction is not None:
        sentences.append(f"Not judged: {score.contradiction}.")
    if score.incomplete is not None:
        sentences.append(f"Incomplete: {score.incomplete}.")
    if score.on_limits and score.contradiction is None:  # otherwise no limit is judged
        sentences.append(f"{counts_of(score.on_limits).text}.")
    if score.active_rules.partial and score.is_judged:
        sentences.append("An incomplete result is judged as if it were complete (--partial).")
    certain = [item.certain for item in score.on_limits if item.certain is not None]
    if certain and score.contradiction is None:
        sentences.append(
            f"For {sum(certain)} of {len(certain)} limits with a 95 % interval, the interval does not span the limit."
        )
    return " ".join(sentences) or "No limits were given: there is no verdict."


# ---- the header: data, duration, method, settings and time


def data_set_name(score: Score) -> str:
    """Return the name of the data set of the truth; empty if it is unknown."""
    for text in _paths(score, TRUTH_ROLES):
        path = PurePath(text)
        while path.name in ("groundtruth.csv", "loc", "nav") and path.parent.name:  # parts of a data set folder
            path = path.parent
        return path.name
    return ""


def run_facts(score: Score) -> tuple[tuple[str, str], ...]:
    """Return the facts of the header, each with its name; unknown facts are not shown."""
    truths = _paths(score, TRUTH_FILES) or _paths(score, TRUTH_ROLES)
    facts = {
        "Truth": ", ".join(truths),
        "Read as": ", ".join(_paths(score, READ_ROLES)),
        "Judged": ", ".join(_paths(score, RESULT_ROLES)),
        "Drive": _drive_text(score),
        "Map": _map_text(score),
        "Method": _method_text(score),
        "Poses converted": "" if score.convention is None else "yes, see Method under test",
        "Configuration": _changed_settings(score),
        "Scored": _scored_text(score),
    }
    return tuple((name, text) for name, text in facts.items() if text)


def provenance_texts(score: Score) -> dict[str, str]:
    """Return the provenance of a score as texts by the keys of the JSON; empty if it is unknown."""
    return {name: setting_text(value) for name, value in flatten(to_plain(score.provenance) or {}).items()}


def _paths(score: Score, roles: Sequence[str]) -> list[str]:
    inputs = {} if score.provenance is None else score.provenance.inputs
    return list(dict.fromkeys(inputs[role].path for role in roles if role in inputs))


def _drive_text(score: Score) -> str:
    association = score.association
    if association is None:
        return ""
    path = f"{number(association.path_length_m)} m in {number(association.duration_s)} s"
    frames = "poses" if association.images is None else "stereo pairs"
    return f"{path}, {association.matched} {frames} with a truth"


def _map_text(score: Score) -> str:
    if score.cloud is None:
        return ""
    points, pairs = score.number("points"), score.number("pairs")
    return f"{_count_text(points)} points of {_count_text(pairs)} stereo {'pair' if pairs == 1 else 'pairs'}"


def _count_text(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.0f}"


def _method_text(score: Score) -> str:
    method = score.method
    if method is None:
        return "not named in the inputs"
    return f"{method.name} {method.version or 'of unknown version'} ({method.kind})"


def _changed_settings(score: Score) -> str:
    """Return the settings that differ from their defaults; empty if no setting is known."""
    if score.provenance is None or not score.provenance.configuration:
        return ""
    changed = [f"{item.name} {setting_text(item.value)}" for item in changed_settings(score)]
    if not has_all_settings(score):
        changed.append(f"other settings {UNKNOWN}")
    return "; ".join(changed) or "defaults"


def _scored_text(score: Score) -> str:
    made = score.provenance
    if made is None:
        return ""
    known = {name: made.host[name] for name in ("machine", "system", "python") if name in made.host}
    host = ", ".join(f"Python {value}" if name == "python" else value for name, value in known.items())
    by = f"by sfr_loc_map {made.version or UNKNOWN}{f' on {host}' if host else ''}"
    return f"{made.time or 'time unknown'} {by}"


# ---- what restricts the score


def restrictions_of(score: Score) -> tuple[str, ...]:
    """Return the warnings and caveats of a score without the contradiction, which the banner states."""
    texts = dict.fromkeys((*score.warnings, *caveats_of(score)))
    return tuple(printable(text) for text in texts if text != score.contradiction)


# ---- what to look at first


class LookFirst(NamedTuple):
    """One item to look at: a phrase for the item and a sentence for the reason."""

    what: str
    why: str


def look_first(score: Score) -> tuple[LookFirst, ...]:
    """Return the first items to look at, in the order of `LOOK_FIRST`.

    A contradiction of estimate and truth and incomplete results are not items, because the banner states them.
    """
    items = chain.from_iterable(items_of(score) for items_of in LOOK_FIRST)
    return tuple(islice(items, MOST_TO_LOOK_AT))


def _findings(score: Score) -> Iterator[LookFirst]:
    """Yield the findings on the method under test."""
    for finding in score.findings:
        yield LookFirst(str(finding.kind), f"Finding on the method under test: {finding}.")


def _missed_limits(score: Score) -> Iterator[LookFirst]:
    """Yield the missed limits, the most exceeded limit first; limits of 0 have no ratio and are last."""
    for view in sorted(verdict_views(score), key=lambda view: (view.item.limit == 0.0, -_use_of(view))):
        if view.item.state is VerdictState.FAIL:
            yield LookFirst(view.name, f"The limit is missed: {_beside_limit(view)}")


def _lost_and_degraded(score: Score) -> Iterator[LookFirst]:
    """Yield the lost and the degraded frames."""
    association = score.association
    if association is None:
        return
    for count, state in ((association.lost, "lost"), (association.degraded, "degraded")):
        if count:
            percent = number(100.0 * count / max(association.matched, 1))
            of_frames = f"{count} of {association.matched} frames ({percent} %)"
            yield LookFirst(f"{state} frames", f"{of_frames} are {state}. They count in every figure like the others.")


def _open_limits(score: Score) -> Iterator[LookFirst]:
    """Yield the limits without enough data, one item for all limits with the same reason."""
    names: dict[str, list[str]] = {}
    for view in verdict_views(score):
        if view.reason:
            names.setdefault(view.reason, []).append(view.name)
    for reason, of_reason in names.items():
        limits = "this limit" if len(of_reason) == 1 else f"these {len(of_reason)} limits"
        yield LookFirst("; ".join(of_reason), f"There is not enough data to judge {limits}: {reason}.")


def _inconsistent_covariance(score: Score) -> Iterator[LookFirst]:
    """Yield each condition over which the mean NEES is outside of its interval."""
    for row in score.rows("nees", subject=Subject.CONSISTENCY, part=POSE):
        if row.mean is None or row.interval is None or row.interval[0] <= row.mean <= row.interval[1]:
            continue
        size = "large" if row.mean < row.interval[0] else "small"
        why = f"Over {label_of(row.condition)} the normalised squared error (NEES) is {number(row.mean)} "
        why += f"instead of {number(row.value)}. {truth_text(score) or EXACT}"
        yield LookFirst(f"the covariance of the odometry, which is too {size}", why.strip())


def _smallest_margin(score: Score) -> Iterator[LookFirst]:
    """Yield the limit that is met with the smallest margin."""
    met = [view for view in verdict_views(score) if view.item.state is VerdictState.PASS]
    if met:
        nearest = max(met, key=_use_of)
        yield LookFirst(nearest.name, f"This limit is met with the smallest margin: {_beside_limit(nearest)}")


def _worst_sub_trajectory(score: Score) -> Iterator[LookFirst]:
    """Yield the sub-trajectory of the first condition that has the largest position error."""
    first = next(iter(plotted_conditions(score)), None)
    largest_m = None if first is None else score.number("position", "max", condition=first.rows.condition)
    if first is None or largest_m is None:
        return
    unit, rows = fitting(METRE, largest_m), first.rows
    why = f"Over {first.over} the largest position error is {number(largest_m, unit=unit)} {unit.symbol}"
    sizes = [(size, index) for index, size in enumerate(error_sizes(rows)) if size is not None]
    if rows.every == 1 and sizes:  # decimated rows may lack the worst sub-trajectory
        _, worst = max(sizes, key=itemgetter(0))
        why += f", at frames {rows.start_frame[worst]} to {rows.end_frame[worst]}"
    yield LookFirst("the worst sub-trajectory", f"{why}.")


LOOK_FIRST: tuple[Callable[[Score], Iterator[LookFirst]], ...] = (
    _findings,
    _missed_limits,
    _lost_and_degraded,
    _open_limits,
    _inconsistent_covariance,
    _smallest_margin,
    _worst_sub_trajectory,
)
"""Items to look at, the most urgent kind first."""


def _beside_limit(view: VerdictView) -> str:
    spans = view.item.certain is False
    remark = " Its 95 % interval spans the limit: more data may change the verdict." if spans else ""
    return f"{view.comparison}.{remark}"


def _use_of(view: VerdictView) -> float:
    return view.use or 0.0
