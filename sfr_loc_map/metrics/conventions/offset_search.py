"""Search for the offset of the stamps that makes an estimate agree best with the truth.

The offset with the least disagreement is searched on a grid that is refined around the best offset. The offset to the
exact stamps of the truth is then preferred if its disagreement is about the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import slerp, unit_quats
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.conventions.disagreement import (
    MIN_POSES,
    disagreement_of,
    disagreements_of_positions,
    eighths,
    path_lengths,
)
from sfr_loc_map.metrics.formulas import Poses, pose_reading
from sfr_loc_map.metrics.frames.true_attitudes import incomplete_attitudes
from sfr_loc_map.stamp_pairing import nearest_stamps

KEPT = 0.9  #: Minimum fraction of the poses of the estimate in the time span of the truth after the offset.
SEARCHED_POSES = 800  #: Maximum number of poses in the search, which bounds the time of a diagnosis to about 0.1 s.
SEARCHED_PERIODS, SEARCHED_NS = 20, 2 * NS_PER_S
"""The search covers offsets of the stamps up to this number of periods of the estimate or this time, whichever is
larger, on both sides of each starting offset. Chosen by hand, above the delays of methods."""
SEARCH_STEPS, SEARCH_ROUNDS = 200, 3
"""Steps of the grid of offsets, and number of grids. Each further grid spans two steps around the best offset of the
previous grid. The step of the last grid is 8 us for a search of 2 s."""
LEAP_SECONDS_NS = 18 * NS_PER_S
"""Difference of GPS time and UTC since 2017, ns. Receivers and computers on a rover may have either time."""
AS_GOOD = 1.1
"""Factor of disagreement up to which an offset to the exact stamps of the truth is preferred. Chosen by hand."""


class Offset(NamedTuple):
    """An offset that is added to the stamps of the estimate, and the remaining disagreement of each sub-trajectory."""

    offset_ns: int
    remaining: FloatArray

    @property
    def disagreement(self) -> float:
        """The mean of the remaining disagreement."""
        return float(np.mean(self.remaining))


def best_offset(estimate: Trajectory, truth: Truth, begin_ns: int) -> Offset | None:
    """Return the offset with the least disagreement; None if no offset keeps enough poses.

    The search starts at `begin_ns`, and at this offset with the leap seconds of GPS time in either direction. The
    stamps of both trajectories ascend, and each occurs once.
    """
    if min(len(estimate), len(truth)) < MIN_POSES:
        return None
    estimate = replace(estimate, quats_xyzw=unit_quats(estimate.quats_xyzw))
    if truth.has_attitude:
        truth = replace(truth, quats_xyzw=unit_quats(truth.quats_xyzw))
    best = Offset(begin_ns, np.full(1, np.inf))
    starts_ns = [begin_ns, begin_ns - LEAP_SECONDS_NS, begin_ns + LEAP_SECONDS_NS]
    reach_ns = max(SEARCHED_PERIODS * period_ns(estimate), SEARCHED_NS)
    for _ in range(SEARCH_ROUNDS):
        grid = np.concatenate(
            [np.linspace(start_ns - reach_ns, start_ns + reach_ns, SEARCH_STEPS + 1) for start_ns in starts_ns]
        )
        best = min((best, *_with_offsets(estimate, truth, grid.astype(np.int64))), key=lambda each: each.disagreement)
        starts_ns = [best.offset_ns]
        reach_ns = reach_ns * 4 // SEARCH_STEPS
    if not np.isfinite(best.disagreement):
        return None
    stamps_ns = estimate.stamps_ns + best.offset_ns
    to_exact_ns = int(np.median(truth.stamps_ns[nearest_stamps(stamps_ns, truth.stamps_ns)[0]] - stamps_ns))
    for exact in _with_offsets(estimate, truth, np.array([best.offset_ns + to_exact_ns])):
        if exact.disagreement <= AS_GOOD * best.disagreement:
            best = exact
    return best


def period_ns(poses: Trajectory) -> int:
    """Return the median period of poses, ns."""
    return int(np.median(np.diff(poses.stamps_ns)))


def _with_offsets(estimate: Trajectory, truth: Truth, offsets_ns: IntArray) -> Iterator[Offset]:
    """Yield the offsets that keep enough frames, each with its disagreement from the interpolated truth.

    Both trajectories have ascending stamps. Attitudes are unit quaternions. Offsets that keep the same frames are
    evaluated in one batch, because the overhead of numpy exceeds the arithmetic for the small arrays of one offset.
    """
    span_ns = truth.stamps_ns[[0, -1]]
    kept = np.searchsorted(estimate.stamps_ns, span_ns - offsets_ns[:, None])
    is_enough = kept[:, 1] - kept[:, 0] >= max(MIN_POSES, round(KEPT * len(estimate)))
    for first, last in np.unique(kept[is_enough], axis=0)[::-1].tolist():  # by ascending offset
        batch_ns = offsets_ns[(kept == (first, last)).all(axis=1)]
        step = max(1, (last - first) // SEARCHED_POSES)
        remaining = _disagreements(estimate[first:last:step], truth, batch_ns)
        yield from (Offset(int(offset_ns), each) for offset_ns, each in zip(batch_ns, remaining, strict=True))


def _disagreements(estimate: Trajectory, truth: Truth, offsets_ns: IntArray) -> FloatArray:
    """Return the disagreement `(K, M)` of each sub-trajectory with each of K offsets, which keep all N poses."""
    stamps_ns = estimate.stamps_ns + offsets_ns[:, None]
    after = np.searchsorted(truth.stamps_ns, stamps_ns, side="right")
    before = after - 1
    share = (stamps_ns - truth.stamps_ns[before]) / (truth.stamps_ns[after] - truth.stamps_ns[before])
    move = truth.positions[after] - truth.positions[before]
    true_positions = truth.positions[before] + share[..., None] * move
    if incomplete_attitudes(truth) is not None:
        return disagreements_of_positions(true_positions, estimate.positions, has_height=truth.has_height)
    starts, ends = eighths(len(estimate))
    lengths_m = path_lengths(true_positions, starts, ends)
    rows = np.concatenate((starts, ends))  # attitudes are needed only in these rows
    row_before = before[:, rows].ravel()
    true_quats = slerp(truth.quats_xyzw[row_before], truth.quats_xyzw[row_before + 1], share[:, rows].ravel())
    positions = np.tile(estimate.positions[rows], (len(offsets_ns), 1))
    quats = np.tile(estimate.quats_xyzw[rows], (len(offsets_ns), 1))
    poses = Poses(true_positions[:, rows].reshape(-1, 3), true_quats, positions, quats)
    places = np.arange(len(positions)).reshape(len(offsets_ns), 2, len(starts))
    errors = pose_reading(poses, places[:, 0].ravel(), places[:, 1].ravel())
    return disagreement_of(errors, lengths_m.ravel()).reshape(lengths_m.shape)
