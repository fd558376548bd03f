"""The expected, judged, missing and extra items of each subject of a score, and the rows that state them.

The source defines the expected items, never the item under test. The row `judged` of a subject contains the number of
expected items (`n`, null if it is unknown) and the fraction of them that is judged (`value`).
docs/metrics.md, "Completeness", has the table of the expected, judged, missing and extra items of each subject.

During a run, images and pairs are expected as soon as their result is due (`due_stamps`). One call for
a set of pairs is expected, at the stamp of any pair.

Items that are expected and have a result, but no ground truth, are neither judged nor missing (`images_without_truth`,
`points_without_truth`). The module `drive` counts the items of the drive. This file has one section for each of the
other subjects, in the order of that table. `shortfall_kinds` states when a subject is incomplete.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.catalogue import ANSWERED_TWICE, CALLS_MISSING, JUDGED, UNANSWERED, UNMEASURED
from sfr_loc_map.metrics.figures.records import ExternalScore
from sfr_loc_map.metrics.figures.row_part import COUNT, Place, RowPart, calls_part
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.figures.subjects import Scope
from sfr_loc_map.metrics.frames.association import nearness_ns
from sfr_loc_map.stamp_pairing import nearest_stamps

CALL_TOLERANCE_NS = 1000  #: Accepted difference between the stamps of a single call, the default of `tolerance_s`.


def has_stamp(expected_ns: IntArray, stamps_ns: IntArray, near_ns: int) -> Mask:
    """Return which expected stamps are nearest to one of the stamps, within `near_ns`; both arrays are ascending.

    Each stamp counts for one expected stamp, so that expected stamps that are close together need one stamp each.
    """
    is_own = np.zeros(len(expected_ns), np.bool_)
    if len(expected_ns):
        nearest, difference = nearest_stamps(stamps_ns, expected_ns)
        is_own[nearest[difference <= near_ns]] = True
    return is_own


def expected_row(part: RowPart, judged: int, expected: int | None) -> Figure:
    """Return the row `judged` of a part: the number of expected items, null if unknown, and the judged fraction."""
    share = None if expected is None else share_of(judged, expected)
    return figure_row(JUDGED, part=part, n=expected, value=share)


def share_rows(name: str, count: int | None, total: int) -> Iterator[Figure]:
    """Yield the rows of a count, None if it is unknown, as a fraction of a total and as a number."""
    yield figure_row(name, n=total, value=None if count is None else share_of(count, total))
    yield figure_row(name, part=COUNT, n=total, value=count)


def share_of(count: int, total: int) -> float | None:
    """Return a count as a fraction of a total, None if the total is 0."""
    return count / total if total else None


def due_stamps(stamps_ns: IntArray, results_ns: IntArray, in_flight_ns: int) -> IntArray:
    """Return the ascending stamps whose results are due.

    Results are due up to the stamp of the last result, and for stamps that are older than `in_flight_ns`.
    """
    if not in_flight_ns or not len(stamps_ns):
        return stamps_ns
    due_ns = stamps_ns.max() - in_flight_ns
    if len(results_ns):
        due_ns = max(due_ns, results_ns.max())
    return np.asarray(stamps_ns[stamps_ns <= due_ns])


# ---- maps


def map_completeness(
    *,
    points: int,
    not_finite: int,
    without_truth: int,
    point_pairs: NDArray[np.integer],
    expected_pairs: int,
    uncovered: Sequence[float | None],
    repeated: int = 0,
) -> Iterator[Figure]:
    """Yield the rows of completeness of a cloud.

    `points` is the number of finite points of the cloud. `point_pairs` contains the pairs of the points. `uncovered` is
    the fraction of the true pixels of each pair in the scored range that have no point, None if the pair has no such
    pixel. `repeated` is the number of points whose pixel or position is that of an earlier point.
    """
    mapped = len(np.unique(point_pairs))
    missing = max(expected_pairs - mapped, 0)
    yield expected_row(RowPart(Scope.MAP), expected_pairs - missing, expected_pairs)
    yield from share_rows("pairs_without_cloud", missing, expected_pairs)
    yield from share_rows("points_without_truth", without_truth, points)
    yield from share_rows("points_not_finite", not_finite, points + not_finite)
    yield from share_rows("points_repeated", repeated, points)
    known = [share for share in uncovered if share is not None]
    yield figure_row("pixels_without_point", n=len(known), value=max(known, default=None))


def with_unmapped_pairs(rows: Sequence[Figure], unmapped: int) -> tuple[Figure, ...]:
    """Return the rows of a scored cloud with `unmapped` further expected pairs, which are in no cloud."""
    (before,) = (row for row in rows if (row.figure, row.part) == ("pairs_without_cloud", COUNT))
    expected = (before.n or 0) + unmapped
    without = int(before.value or 0) + unmapped
    changed = [expected_row(RowPart(Scope.MAP), expected - without, expected)]
    changed += share_rows("pairs_without_cloud", without, expected)
    by_place = {(row.figure, row.part): row for row in changed}
    return tuple(by_place.get((row.figure, row.part), row) for row in rows)


def rows_without_cloud(unmapped: int, pairs: int) -> Iterator[Figure]:
    """Yield the rows of a map whose clouds cannot be scored; `unmapped` of its pairs are in no cloud."""
    yield expected_row(RowPart(Scope.MAP), pairs - unmapped, pairs)
    yield from share_rows("pairs_without_cloud", unmapped, pairs)


# ---- calls


def calls_completeness(
    kind: CallKind,
    stamps_ns: IntArray,
    expected_ns: IntArray | None,
    values: Mapping[Scope, FloatArray],
    place: Place = Place.HOST,
) -> Iterator[Figure]:
    """Yield the rows of completeness of the calls `(N,)` of one kind, relative to the expected pairs.

    `values` contains the times (`CALLS`) and the memory (`MEMORY`) of each call, NaN if not measured. `place` states
    where the calls were measured. One call maps a set of pairs, at the stamp of its last pair. At least one such call,
    at a stamp of the source, is therefore expected. A call belongs to the pair of the nearest stamp; further calls of
    the pair count as duplicates.
    """
    for scope, measured in values.items():
        part = calls_part(scope, kind, place)
        if expected_ns is None or not len(expected_ns):
            yield expected_row(part, 0, None)
            continue
        given = stamps_ns[np.isfinite(measured)]
        expected = np.unique(expected_ns)
        judged, many = judged_calls(kind, given, expected)
        yield expected_row(part, judged, many)
        calls = calls_part("", kind, place)
        missing = UNMEASURED if scope is Scope.MEMORY else CALLS_MISSING
        yield figure_row(missing, part=calls, n=many, value=share_of(many - judged, many))
        if scope is Scope.CALLS:
            yield from wrong_calls(calls, given, expected)


def judged_calls(kind: CallKind, given: IntArray, expected: IntArray) -> tuple[int, int]:
    """Return how many expected calls of a kind were measured, and how many are expected."""
    has_call = has_stamp(expected, np.unique(given), nearness_ns(expected, CALL_TOLERANCE_NS))
    judged = int(np.count_nonzero(has_call))
    if kind not in (CallKind.LOCALISATION, CallKind.MAPPING):  # a call for a set of pairs
        return min(judged, 1), 1
    return judged, len(expected)


def wrong_calls(part: RowPart, given: IntArray, expected: IntArray) -> Iterator[Figure]:
    """Yield the rows of the measured calls that belong to no expected pair, or to the pair of another call."""
    total = len(given)
    unique, counts = np.unique(given, return_counts=True)
    pair, difference = nearest_stamps(unique, expected)
    is_of_drive = difference <= nearness_ns(expected, CALL_TOLERANCE_NS)
    other = int(counts[~is_of_drive].sum())
    pairs = pair[is_of_drive]
    repeated_stamps = int((counts[is_of_drive] - 1).sum())
    doubled = repeated_stamps + len(pairs) - len(np.unique(pairs))
    yield figure_row("calls_other", part=part, n=total, value=share_of(other, total))
    yield figure_row("calls_doubled", part=part, n=total, value=share_of(doubled, total))


def answers_completeness(node: ExternalScore) -> Iterator[Figure]:
    """Yield the completeness of the calls of an external node, from its answers and the published pairs.

    A missing or repeated answer counts in the calls and also in the drive or the map. The calls and the
    drive or map have separate figures, because other limits accept the shortfall of the calls (`shortfall_kinds`).
    """
    kind = CallKind(node.task)
    answers = node.answers
    received = answers.answered + answers.late + answers.doubled + answers.other_stamp
    missing = answers.missing, answers.pairs
    other = answers.other_stamp, received
    doubled = answers.doubled, received
    yield expected_row(calls_part(Scope.CALLS, kind), answers.answered, answers.pairs)
    counts = {CALLS_MISSING: missing, "calls_other": other, "calls_doubled": doubled}
    counts |= {UNANSWERED: missing, ANSWERED_TWICE: doubled}
    for figure, (count, total) in counts.items():
        yield figure_row(figure, part=kind, n=total, value=share_of(count, total))
    if node.process is not None:  # memory of all its processes over the complete run
        measured = int(node.process.peak_rss_bytes > 0)
        yield expected_row(calls_part(Scope.MEMORY, kind), measured, 1)
        yield figure_row(UNMEASURED, part=kind, n=1, value=1 - measured)


# ---- live runs


def live_completeness(received: int, dropped: int, restarts: int, publisher_changes: int) -> Iterator[Figure]:
    """Yield the rows of completeness of a live run: messages, restarts of the score, and changes of publishers."""
    yield expected_row(RowPart(Scope.LIVE), received, received + dropped)
    yield from share_rows("dropped", dropped, received + dropped)
    yield figure_row("restarts", value=restarts)
    yield figure_row("publisher_changes", value=publisher_changes)


# ---- stored scores


def inputs_completeness(changed: int, present: int) -> Iterator[Figure]:
    """Yield the rows of the inputs of a stored score that still exist, and of those that were changed since."""
    yield expected_row(RowPart(Scope.INPUTS), present - changed, present)
    yield from share_rows("inputs_changed", changed, present)


# ---- suites


def suite_completeness(scored: int, planned: int | None) -> Figure:
    """Return the row of completeness of a suite: planned results, and those with a score; None if there is no plan."""
    return expected_row(RowPart(Scope.SUITE), scored, planned)
