"""Comparison of several estimates: the difference of their errors, with its confidence interval and p-value.

Sub-trajectories of the same condition with the same first and last stamp are paired, so that a sub-trajectory that is
difficult for both estimates does not add to the scatter of the difference. For the interval of the difference, both
series are resampled in the same blocks, which preserves the pairing (circular block bootstrap,
`metrics.statistics.intervals`).

The stamps of sub-trajectories are stored with the data of the plots, which have every n-th sub-trajectory of a long
drive. A comparison of long drives therefore uses samples, and `PairedDifference.every` states n.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from enum import StrEnum
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace
from scipy.special import stdtr

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.metrics.figures.catalogue import KINDS, TOTAL
from sfr_loc_map.metrics.figures.details import SubTrajectoryRows, Values
from sfr_loc_map.metrics.figures.records import MethodRecord, Record
from sfr_loc_map.metrics.figures.row_part import RowPart
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.formulas import statistics
from sfr_loc_map.metrics.judging.incomplete import strictly_missing
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.statistics.intervals import Interval, holm, scatter_of_difference
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.metrics.trajectory.trajectory_errors import overlap_of

SCHEMA = "sfr-compare/1"
SIGNIFICANT = 0.05  #: Significance level of the corrected p-value.
SAME_TRUTH_M = 1e-6  #: Largest difference of true positions that is attributed to rounding, m.
_PRECISION = 1e-9  #: Rounding of the errors in the details of a score.


class Outcome(StrEnum):
    """Outcome of the comparison of another score with the first score."""

    BETTER = "better"
    WORSE = "worse"
    EQUAL = "equal"
    NO_DIFFERENCE = "no difference shown"
    NOT_ENOUGH_DATA = "not enough data"
    INCOMPLETE = "incomplete"


class PairedDifference(Record, frozen=True, kw_only=True, omit_defaults=False):
    """One figure over the sub-trajectories of one condition that two scores have in common."""

    name: str  #: Name of the other score.
    condition: str  #: Condition that ends the sub-trajectories.
    figure: str  #: Figure of the catalogue whose mean + 3 sigma is compared.
    unit: str  #: Unit of the figure.
    #: Every n-th sub-trajectory of both scores is compared, with the larger n of the two scores; 1 if all are compared.
    every: int
    count: int  #: Number of these sub-trajectories that are common, by their first and last stamp.
    left_out: tuple[int, int]  #: Number of these sub-trajectories that only the first or only the other score has.
    first: float | None = None  #: Mean + 3 sigma of the first score over the common sub-trajectories.
    other: float | None = None  #: Mean + 3 sigma of the other score over the common sub-trajectories.
    difference: float | None = None  #: Other score minus first score; negative if the other score is better.
    ci95: Interval | None = None  #: 95 % interval of the difference.
    #: Outcome; `no difference shown` if the interval contains zero, or if `p_corrected` exceeds 0.05.
    outcome: Outcome = msgspec.field(name="verdict", default=Outcome.NOT_ENOUGH_DATA)
    p: float | None = None  #: p-value of the difference; None without a scatter.
    p_corrected: float | None = None  #: p-value corrected for the number of comparisons (Holm).


class SideBySide(Record, frozen=True, kw_only=True, omit_defaults=False):
    """One statistic of a figure of complete runs. The values of the runs are not paired by sub-trajectory.

    `values` are the values of the runs, None if unknown.
    """

    label: str = msgspec.field(name="figure")  #: Figure, part and statistic in one text.
    unit: str
    values: tuple[float | None, ...]
    figure: str = msgspec.field(name="kind")  #: Figure of the catalogue.
    condition: str | None = None
    part: RowPart | None = None
    statistic: str


class Comparison(Record, frozen=True, kw_only=True, omit_defaults=False):
    """Comparison of the other scores with the first: names, methods, and differences by score, condition and figure."""

    names: tuple[str, ...]
    methods: tuple[MethodRecord | None, ...] = ()
    #: Expected data that each score cannot judge, even if its rules accept this; null if there are none.
    incomplete: tuple[str | None, ...] = ()
    pairs: tuple[PairedDifference, ...]
    side_by_side: tuple[SideBySide, ...]

    def incomplete_scores(self, other: str) -> list[str]:
        """Return the names of the incomplete scores among the first score and another score."""
        scores = zip(self.names, self.incomplete, strict=True)
        compared = (self.names[0], other)
        return [name for name, missing in scores if name in compared and missing is not None]

    def to_dict(self) -> dict[str, object]:
        """Return the comparison as JSON values."""
        return {"schema": SCHEMA, **to_plain(self)}


def compare_scores(scores: Sequence[Score], names: Sequence[str]) -> Comparison:
    """Return the comparison of the other scores with the first.

    MetricsError if there are fewer than two scores, if the scores have nothing in common or are not of the same data,
    or if they have other than one unique name each.
    """
    if len(scores) < 2:
        raise MetricsError(f"a comparison requires at least two scores, found {len(scores)}: give several score files")
    if len(names) != len(scores) or len(set(names)) < len(names):
        raise MetricsError(f"{len(scores)} scores are named {', '.join(names)}: give each score a unique name")
    first, *others = scores
    for score, name in zip(others, names[1:], strict=True):
        check_same_data(first, score, (names[0], name))
    pairs = [pair for score, name in zip(others, names[1:], strict=True) for pair in _paired(first, score, name)]
    side_by_side = tuple(_side_by_side(scores))
    if not any(pair.count or pair.every > 1 for pair in pairs) and not side_by_side:  # samples may have none in common
        raise MetricsError("the scores have no condition and no figure in common: score the same data and conditions")
    missing = [strictly_missing(score) for score in scores]
    is_incomplete = {
        name: missing[0] is not None or text is not None for name, text in zip(names[1:], missing[1:], strict=True)
    }
    corrected = holm([pair.p for pair in pairs])
    return Comparison(
        names=tuple(names),
        methods=tuple(score.method for score in scores),
        incomplete=tuple(missing),
        pairs=tuple(
            _concluded(pair, p, is_incomplete=is_incomplete[pair.name])
            for pair, p in zip(pairs, corrected, strict=True)
        ),
        side_by_side=side_by_side,
    )


def _concluded(pair: PairedDifference, p_corrected: float | None, *, is_incomplete: bool) -> PairedDifference:
    """Return a difference with its corrected p-value, and the outcome by this p-value and the completeness."""
    outcome = pair.outcome
    if is_incomplete:
        outcome = Outcome.INCOMPLETE
    elif p_corrected is not None and p_corrected > SIGNIFICANT:
        outcome = Outcome.NO_DIFFERENCE
    return replace(pair, p_corrected=p_corrected, outcome=outcome)


def _side_by_side(scores: Sequence[Score]) -> Iterator[SideBySide]:
    """Yield every figure of whole runs that at least two scores have, by the statistics of the catalogue."""
    rows = {row.keys: row for score in scores for row in score.figures if _is_of_a_whole_run(score, row)}
    of_scores = [{row.keys: row for row in score.figures} for score in scores]
    for key, row in rows.items():
        for statistic in _statistics_side_by_side(row):
            found = [None if key not in known else known[key].statistic(statistic) for known in of_scores]
            if sum(value is not None for value in found) > 1:
                words = (row.figure, row.part, "" if statistic == "value" else statistic)
                yield SideBySide(
                    label=" ".join(filter(None, words)),
                    unit=row.unit,
                    values=tuple(found),
                    figure=row.figure,
                    condition=row.condition,
                    part=row.part,
                    statistic=statistic,
                )


def _is_of_a_whole_run(score: Score, row: Figure) -> bool:
    """Return whether a row is shown side by side: all rows of map and calls, the judged rows of the trajectory."""
    if row.subject is Subject.TRAJECTORY:
        return score.is_judged_row(row)
    return row.subject in (Subject.MAP, Subject.TIMING, Subject.MEMORY)


def _statistics_side_by_side(row: Figure) -> Sequence[str]:
    """Return the statistics by which runs are compared, without the statistic that is compared by pairs."""
    compared = KINDS[row.figure].compared if row.figure in KINDS else ()
    return [name for name in compared if row.subject is not Subject.TRAJECTORY or name != TOTAL]


def _paired(first: Score, other: Score, name: str) -> Iterator[PairedDifference]:
    if first.association is None or other.association is None:  # a map score has no sub-trajectories
        return
    readings = first.association.reading, other.association.reading
    if readings[0] != readings[1]:
        used = f"'{name}' is re-based by {readings[1]}, the first score by {readings[0]}"
        raise MetricsError(f"{used}: score both with the same option rebase")
    for mine, theirs in itertools.product(_sub_trajectories(first), _sub_trajectories(other)):
        if mine.condition == theirs.condition:
            yield from _paired_rows(mine, theirs, name)


def _sub_trajectories(score: Score) -> tuple[SubTrajectoryRows, ...]:
    details = score.details
    return () if details is None or details.trajectory is None else details.trajectory.sub_trajectories


class CommonRows(NamedTuple):
    """The compared sub-trajectories of two scores over one condition, as rows of the data of their plots."""

    every: int  #: Every n-th sub-trajectory is compared; n is a power of two in each score.
    first: list[int]  #: Rows of the common sub-trajectories in the first score.
    other: list[int]  #: Rows of the same sub-trajectories in the other score.
    left_out: tuple[int, int]

    @classmethod
    def of(cls, mine: SubTrajectoryRows, theirs: SubTrajectoryRows) -> CommonRows:
        """Return the compared sub-trajectories; the score with more of them is decimated like the other."""
        every = max(mine.every, theirs.every)
        spans, other_spans = (_spans(rows, every // rows.every) for rows in (mine, theirs))
        common = [span for span in spans if span in other_spans]
        left_out = (len(spans) - len(common), len(other_spans) - len(common))
        return cls(every, [spans[span] for span in common], [other_spans[span] for span in common], left_out)


def _spans(rows: SubTrajectoryRows, step: int) -> dict[tuple[int, int], int]:
    """Return the index of every `step`-th row, by the first and last stamp of the row."""
    stamps = zip(rows.start_stamp_ns, rows.end_stamp_ns, strict=True)
    return {span: number for number, span in enumerate(stamps) if number % step == 0}


def _paired_rows(mine: SubTrajectoryRows, theirs: SubTrajectoryRows, name: str) -> Iterator[PairedDifference]:
    """Yield the differences over the sub-trajectories of one condition that have the same first and last stamp."""
    rows = CommonRows.of(mine, theirs)
    overlap = _overlap(np.array(mine.start_frame)[rows.first], np.array(mine.end_frame)[rows.first])
    for kind in KINDS.values():
        columns, other_columns = mine.error_columns(kind.name), theirs.error_columns(kind.name)
        if TOTAL not in kind.tested or not columns or not other_columns:
            continue
        errors = _errors_at(columns, rows.first)
        other_errors = _errors_at(other_columns, rows.other)
        test = TestedDifference.of(errors, other_errors, overlap, is_unsigned=kind.is_unsigned)
        yield PairedDifference(
            name=name,
            condition=mine.condition,
            figure=kind.name,
            unit=kind.unit,
            every=rows.every,
            count=len(rows.first),
            left_out=rows.left_out,
            **test._asdict(),
        )


def _overlap(starts: IntArray, ends: IntArray) -> float:
    """Return the overlap of the common sub-trajectories. Their typical spacing may exceed that of the scores."""
    spacing = int(np.median(np.diff(starts))) if len(starts) > 1 else 1
    return overlap_of(starts, ends, max(spacing, 1))


def _errors_at(columns: Sequence[Values], rows: Sequence[int]) -> FloatArray:
    """Return the errors `(N, d)` of some rows, NaN if unknown."""
    return np.column_stack([np.array(column, np.float64)[rows] for column in columns])


class TestedDifference(NamedTuple):
    """The difference of two mean + 3 sigma over common sub-trajectories; see the fields of `PairedDifference`."""

    first: float | None
    other: float | None
    difference: float | None
    ci95: Interval | None
    outcome: Outcome
    p: float | None

    @classmethod
    def of(cls, errors: FloatArray, others: FloatArray, overlap: float, *, is_unsigned: bool) -> TestedDifference:
        """Return the difference of the errors `(N, d)` of the other score from those of the first, and its outcome."""
        first = statistics(errors).mean_plus_3sigma
        other = statistics(others).mean_plus_3sigma
        if first is None or other is None:  # too few errors, or unknown attitudes
            return cls(None, None, None, None, Outcome.NOT_ENOUGH_DATA, None)
        difference = other - first
        if np.array_equal(errors, others):
            return cls(first, other, difference, (0.0, 0.0), Outcome.EQUAL, None)
        scatter = scatter_of_difference(errors, others, overlap, unsigned=is_unsigned)
        if scatter is None:
            return cls(first, other, difference, None, Outcome.NOT_ENOUGH_DATA, None)
        half = scatter.half_width + _PRECISION
        p = None
        if scatter.sigma > 0.0:
            p = 2.0 * float(stdtr(scatter.freedom, -max(abs(difference) - _PRECISION, 0.0) / scatter.sigma))
        if abs(difference) <= half:
            outcome = Outcome.NO_DIFFERENCE
        else:
            outcome = Outcome.BETTER if difference < 0 else Outcome.WORSE
        return cls(first, other, difference, (difference - half, difference + half), outcome, p)


def check_same_data(first: Score, other: Score, names: tuple[str, str]) -> None:
    """Check that two scores were made with the same truth; MetricsError if not.

    Truths are compared by their hashes. If a score has no hash of the truth of a drive, the true positions at common
    stamps are compared. Scores without hashes and without common stamps are accepted.
    """
    for role in ("truth", "map_truth"):
        inputs = ({} if score.provenance is None else score.provenance.inputs for score in (first, other))
        mine, theirs = (item.get(role) for item in inputs)
        if mine is None or theirs is None:
            if role == "truth":
                check_same_positions(first, other, names)
            continue
        # hash of the values, or of the file for scores without the hash of the values
        has_values = mine.data_sha256 is not None and theirs.data_sha256 is not None
        same = mine.data_sha256 == theirs.data_sha256 if has_values else mine.sha256 == theirs.sha256
        if not same:
            what = role.replace("_", " ")
            raise MetricsError(
                f"the {what} of '{names[0]}' is '{mine.path}', but the {what} of '{names[1]}' is '{theirs.path}': "
                "compare scores of the same data"
            )


def check_same_positions(first: Score, other: Score, names: tuple[str, str]) -> None:
    """Check that the true positions of two scores agree at the common stamps of their plots; MetricsError if not."""
    stamps_ns, positions = true_positions(first)
    other_stamps_ns, other_positions = true_positions(other)
    _, rows, other_rows = np.intersect1d(stamps_ns, other_stamps_ns, return_indices=True)
    distances_m = np.linalg.norm(positions[rows] - other_positions[other_rows], axis=1)
    largest_m = float(np.max(distances_m, initial=0.0))
    if largest_m > SAME_TRUTH_M:
        raise MetricsError(
            f"the truth of '{names[0]}' and the truth of '{names[1]}' differ by {largest_m:.3g} m at the same stamp: "
            "compare scores of the same data"
        )


def true_positions(score: Score) -> tuple[IntArray, FloatArray]:
    """Return the stamps `(F,)` and the true positions `(F, 3)`, m, of the plots of a score; empty without these."""
    details = None if score.details is None else score.details.trajectory
    path = None if details is None else details.path
    if path is None:
        return np.empty(0, np.int64), np.empty((0, 3))
    positions = np.array((path.truth_x_m, path.truth_y_m, path.truth_z_m), np.float64)
    return np.array(path.stamp_ns, np.int64), positions.T
