"""Which of several estimates is better, by how much, and is that more than chance?

Sub-trajectories of the same condition with the same first and last stamp are paired, so that what makes a stretch hard
for both does not blur the difference. For the interval on the difference both series are resampled in the very same
blocks (circular block bootstrap, as for the interval of one figure, see `metrics.statistics`), which keeps the pairing.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import Annotated, Any

import numpy as np
from scipy.special import stdtr

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.config import CallKind, Condition
from sfr_loc_map.metrics.limits import value_at
from sfr_loc_map.metrics.score import Interval, Key, MethodRecord, Record, Score
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.metrics.statistics import MIN_FREEDOM, MIN_INDEPENDENT, WIDENING, holm, resampled, student_quantile
from sfr_loc_map.metrics.trajectory_error import COLUMNS, HEADING
from sfr_loc_map.metrics.trajectory_score import FIGURES

SCHEMA = "sfr-compare/1"
KINDS = (CallKind.LOCALISATION, CallKind.MAPPING)
SIGNIFICANT = 0.05  #: A corrected probability of chance above it shows no difference.
_PRECISION = 1e-9  #: The errors in a score's details are rounded to this.


class Outcome(StrEnum):
    """What is said of the other score."""

    BETTER = "better"
    WORSE = "worse"
    EQUAL = "equal"
    NO_DIFFERENCE = "no difference shown"
    NOT_ENOUGH_DATA = "not enough data"


class PairedDifference(Record):
    """One figure of one condition over the sub-trajectories that two scores have in common."""

    name: str  #: Name of the other score.
    condition: Condition  #: What ends the sub-trajectories.
    figure: str  #: `position_m`, `attitude_deg` or `heading_deg`.
    count: int  #: Common sub-trajectories.
    left_out: tuple[int, int]  #: Sub-trajectories of the first and of the other score that are not common.
    first: float | None  #: Mean + 3 sigma of the first score over the common ones.
    other: float | None  #: The same of the other score.
    difference: float | None  #: Other less first: below zero the other is better.
    ci95: Interval | None  #: 95 % interval of the difference.
    #: What it says; `no difference shown` if the interval holds zero, or chance is as likely as 0.05 (`p_corrected`).
    outcome: Annotated[Outcome, Key("verdict")] = Outcome.NOT_ENOUGH_DATA
    p: float | None = None  #: Probability of such a difference by chance, by the same scatter; None without one.
    p_corrected: float | None = None  #: The same corrected for the number of comparisons (Holm).


class SideBySide(Record):
    """One figure of whole runs, which cannot be paired: its place in the score, a value for each (None: no value)."""

    figure: str
    values: tuple[float | None, ...]


class Comparison(Record):
    """Scores compared with the first of them: name and method of each, pairs by score, condition and figure."""

    names: tuple[str, ...]
    methods: tuple[MethodRecord | None, ...] = ()
    pairs: tuple[PairedDifference, ...]
    side_by_side: tuple[SideBySide, ...]

    def to_dict(self) -> dict[str, object]:
        """Return it as JSON values."""
        return {"schema": SCHEMA, **{key: to_plain(value) for key, value in vars(self).items()}}


SIDE_BY_SIDE = {
    **{f"map.point_error_m.{name}": f"map.errors.point_error_m.{name}" for name in ("mean", "mean_plus_3sigma")},
    "map.coverage": "map.coverage",
    **{f"timing.{kind}_s.{name}": f"timing.{kind}.{name}" for kind in KINDS for name in ("p50", "p95")},
    **{f"memory.{kind}_peak_bytes": f"memory.{kind}.peak_bytes" for kind in KINDS},
}
"""Figures of whole runs by their place in the JSON of the score, and in the score itself."""


def compare_scores(scores: Sequence[Score], names: Sequence[str]) -> Comparison:
    """Return the comparison of scores with the first of them; MetricsError if they have nothing in common."""
    if len(scores) < 2:
        raise MetricsError(f"a comparison needs two scores or more, found {len(scores)}: give several score files")
    others = list(zip(scores[1:], names[1:], strict=True))
    for score, name in others:
        check_same_data(scores[0], score, (names[0], name))
    pairs = [pair for score, name in others for pair in _paired(scores[0], score, name)]
    pairs = [replace(pair, p_corrected=p) for pair, p in zip(pairs, holm([pair.p for pair in pairs]), strict=True)]
    pairs = [
        replace(it, outcome=Outcome.NO_DIFFERENCE) if (it.p_corrected or 0.0) > SIGNIFICANT else it for it in pairs
    ]
    side_by_side = []
    for name, place in SIDE_BY_SIDE.items():
        values = tuple(value_at(score, place) for score in scores)
        if sum(value is not None for value in values) > 1:
            side_by_side.append(SideBySide(figure=name, values=values))
    if not pairs and not side_by_side:
        raise MetricsError("the scores have no condition and no figure in common: score the same data alike")
    methods = tuple(score.method for score in scores)
    return Comparison(names=tuple(names), methods=methods, pairs=tuple(pairs), side_by_side=tuple(side_by_side))


def _paired(first: Score, other: Score, name: str) -> Iterator[PairedDifference]:
    if first.trajectory is None or other.trajectory is None:  # a map alone has nothing to pair
        return
    rebase = [part.first.rebase for part in (first.trajectory, other.trajectory)]
    if rebase[0] != rebase[1]:
        raise MetricsError(f"'{name}' is re-based by {rebase[1]}, the first score by {rebase[0]}: score both alike")
    both = (value_at(score, "details.trajectory.sub_trajectories") or () for score in (first, other))
    for mine, theirs in itertools.product(*both):
        if mine.condition != theirs.condition:
            continue
        spans = [list(zip(part.start_stamp_ns, part.end_stamp_ns, strict=True)) for part in (mine, theirs)]
        in_other = {span: row for row, span in enumerate(spans[1])}
        rows = np.array([(row, in_other[span]) for row, span in enumerate(spans[0]) if span in in_other], np.intp)
        if not len(rows):
            continue
        a, b = (
            np.column_stack([np.asarray(getattr(part, key), np.float64)[which] for key in COLUMNS[: HEADING + 1]])
            for which, part in zip(rows.T, (mine, theirs), strict=True)
        )
        starts, ends = (np.asarray(frames)[rows[:, 0]] for frames in (mine.start_frame, mine.end_frame))
        spacing = max(int(np.median(np.diff(starts))), 1) if len(starts) > 1 else 1
        overlap = float(np.mean(-(-(ends - starts) // spacing)))  # as `trajectory_score` counts it
        left_out = (len(spans[0]) - len(rows), len(spans[1]) - len(rows))
        for figure, columns in FIGURES.items():
            said = _difference(a[:, columns], b[:, columns], overlap)
            common: dict[str, Any] = {"name": name, "condition": mine.condition, "figure": figure, "count": len(rows)}
            yield PairedDifference(**common, left_out=left_out, **said)


def _difference(a: FloatArray, b: FloatArray, overlap: float) -> dict[str, Any]:
    """Return the figures of errors `(N, d)` of both, their difference, its interval and the outcome."""
    said: dict[str, Any] = dict.fromkeys(("first", "other", "difference", "ci95"))
    if len(a) < 2 or not (np.isfinite(a).all() and np.isfinite(b).all()):  # attitudes are not known
        return said
    first, other = (
        float(np.sqrt(np.cumsum(np.square(errors.mean(axis=0)))[-1]))
        + 3.0 * float(np.sqrt(np.cumsum(np.square(errors.std(axis=0, ddof=1)))[-1]))
        for errors in (a, b)
    )
    difference, independent = other - first, len(a) / overlap
    said |= {"first": first, "other": other, "difference": difference}
    if np.array_equal(a, b):
        return said | {"ci95": (0.0, 0.0), "outcome": Outcome.EQUAL}
    if independent < MIN_INDEPENDENT:
        return said
    share, figures = 1.0, []
    for errors in (a, b):
        mean = errors.mean(axis=0)
        offsets = errors - mean
        centred = np.column_stack((np.ones(len(errors)), offsets, offsets * offsets))
        _, drawn, share = resampled(centred, mean, overlap)
        figures.append(drawn)
    scatter = np.std(figures[1] - figures[0])
    share *= 1.0 - 1.0 / independent
    freedom = max(independent - 1.0, MIN_FREEDOM)
    sigma = float(WIDENING * scatter / np.sqrt(share))
    half, p = student_quantile(0.975, freedom) * sigma + _PRECISION, None
    if sigma > 0.0:
        p = 2.0 * float(stdtr(freedom, -max(abs(difference) - _PRECISION, 0.0) / sigma))
    outcome = Outcome.BETTER if difference < 0 else Outcome.WORSE
    outcome = Outcome.NO_DIFFERENCE if abs(difference) <= half else outcome
    return said | {"ci95": (difference - half, difference + half), "outcome": outcome, "p": p}


def check_same_data(first: Score, other: Score, names: tuple[str, str]) -> None:
    """Check that two scores were made with the same truth, by its hash; MetricsError if not."""
    for role in ("truth", "map_truth"):
        inputs = ({} if score.provenance is None else score.provenance.inputs for score in (first, other))
        mine, theirs = (item.get(role) for item in inputs)
        if mine is None or theirs is None:
            continue
        # the values, or the files of scores that do not have the hash of the values
        kind = "data_sha256" if mine.data_sha256 and theirs.data_sha256 else "sha256"
        if getattr(mine, kind) != getattr(theirs, kind):
            what = role.replace("_", " ")
            raise MetricsError(
                f"different data: the {what} of '{names[0]}' is '{mine.path}', that of '{names[1]}' '{theirs.path}'; "
                "compare scores of the same data"
            )
