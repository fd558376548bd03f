"""Completeness of a map, of the calls and of a live run, and the rows of the table of figures that state it.

The source defines the expected items, never the item under test. The row `judged` of a scope contains the number of
expected items and the fraction that can be judged. The other rows count what is missing or wrong.
`shortfall_kinds` contains the table of these rows, `metrics.judging` decides by them whether a verdict is possible, and
`drive` makes those of a drive. See docs/metrics.md, "Completeness".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.frames.association import has_own, nearness_ns
from sfr_loc_map.metrics.table.row_part import Place, RowPart, Scope
from sfr_loc_map.metrics.table.rows import Figure, figure_row
from sfr_loc_map.stamp_pairing import nearest_stamps


def expected_row(part: RowPart, judged: int, expected: int | None) -> Figure:
    """Return the row of the number of expected items of a part and of the judged fraction; null if unknown."""
    return figure_row(
        "judged", part=part.text, n=expected, value=None if expected is None else share_of(judged, expected)
    )


def share_rows(name: str, count: int | None, total: int) -> Iterator[Figure]:
    """Yield the rows of a count, None if it is unknown, as a fraction of a total and as a number."""
    yield figure_row(name, n=total, value=None if count is None else share_of(count, total))
    yield figure_row(name, part="count", n=total, value=count)


def share_of(count: int, total: int) -> float | None:
    """Return a count as a fraction of a total, None if the total is 0."""
    return count / total if total else None


# ---- maps


def map_completeness(
    points: int,
    not_finite: int,
    without_truth: int,
    point_pairs: NDArray[np.integer],
    expected_pairs: int,
    bare: Sequence[float | None],
    repeated: int = 0,
) -> Iterator[Figure]:
    """Yield the rows of completeness of a cloud.

    `points` is the number of finite points of the cloud. `point_pairs` contains the pairs of the points. `bare` is the
    fraction of the true pixels of each pair in the scored range that have no point, None if the pair has no such pixel.
    `repeated` is the number of points whose pixel or position is that of an earlier point.
    """
    mapped = len(np.unique(point_pairs))
    yield expected_row(RowPart(Scope.MAP), mapped, expected_pairs)
    yield from share_rows("pairs_without_cloud", max(expected_pairs - mapped, 0), expected_pairs)
    yield from share_rows("points_without_truth", without_truth, points)
    yield from share_rows("points_not_finite", not_finite, points + not_finite)
    yield from share_rows("points_repeated", repeated, points)
    known = [share for share in bare if share is not None]
    yield figure_row("pixels_without_point", n=len(known), value=max(known, default=None))


def with_unmapped_pairs(rows: Sequence[Figure], unmapped: int) -> tuple[Figure, ...]:
    """Return the rows of the score of a cloud after further expected pairs that have no cloud."""
    (bare,) = (row for row in rows if (row.figure, row.part) == ("pairs_without_cloud", "count"))
    expected = (bare.n or 0) + unmapped
    without = int(bare.value or 0) + unmapped
    changed = [expected_row(RowPart(Scope.MAP), expected - without, expected)]
    changed += share_rows("pairs_without_cloud", without, expected)
    by_place = {(row.figure, row.part): row for row in changed}
    return tuple(by_place.get((row.figure, row.part), row) for row in rows)


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
        part = RowPart(scope, kind, place)
        if expected_ns is None or not len(expected_ns):
            yield expected_row(part, 0, None)
            continue
        given, expected = stamps_ns[np.isfinite(measured)], np.unique(expected_ns)
        judged, many = judged_calls(kind, given, expected)
        yield expected_row(part, judged, many)
        if scope is Scope.CALLS:
            calls = part.of_calls.text
            yield figure_row("calls_missing", part=calls, n=many, value=share_of(many - judged, many))
            yield from wrong_calls(calls, given, expected)


def judged_calls(kind: CallKind, given: IntArray, expected: IntArray) -> tuple[int, int]:
    """Return how many expected calls of a kind were measured, and how many are expected."""
    has_call = has_own(expected, np.unique(given), nearness_ns(expected))
    judged, many = int(np.count_nonzero(has_call)), len(expected)
    if kind not in (CallKind.LOCALISATION, CallKind.MAPPING):
        judged, many = min(judged, 1), 1
    return judged, many


def wrong_calls(part: str | None, given: IntArray, expected: IntArray) -> Iterator[Figure]:
    """Yield the rows of the measured calls that belong to no expected pair, or to the pair of another call."""
    total = len(given)
    unique, counts = np.unique(given, return_counts=True)
    pair, difference = nearest_stamps(unique, expected)
    is_of_drive = difference <= nearness_ns(expected)
    other = int(counts[~is_of_drive].sum())
    pairs = pair[is_of_drive]
    repeated_stamps = int((counts - 1).sum())
    doubled = repeated_stamps + len(pairs) - len(np.unique(pairs))
    yield figure_row("calls_other", part=part, n=total, value=share_of(other, total))
    yield figure_row("calls_doubled", part=part, n=total, value=share_of(doubled, total))


# ---- live runs


def live_completeness(received: int, dropped: int, restarts: int) -> Iterator[Figure]:
    """Yield the rows of completeness of a live run: received and dropped messages, and restarts of the score."""
    yield expected_row(RowPart(Scope.LIVE), received, received + dropped)
    yield from share_rows("dropped", dropped, received + dropped)
    yield figure_row("restarts", value=restarts)
