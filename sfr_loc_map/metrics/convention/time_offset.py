"""The hypothesis that the estimate's clock is off."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.quaternion_kernels import slerp, unit_quats
from sfr_loc_map.geometry.small_linalg import copy_row
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.convention.disagreement import LOOKS_WRONG, MIN_POSES, Hypothesis, case_of, disagreement
from sfr_loc_map.metrics.trajectory.stamp_matching import are_all, unique_rows

OFFSET_STEPS = 200
AS_GOOD = 1.1
"""An offset to the stamps of the truth themselves is taken for the best one if it is this near to it."""
STAMP_NOISE_NS = 1_000


def time_offset_hypotheses(estimate: Trajectory, truth: Trajectory, before: float | None) -> Iterator[Hypothesis]:
    """Yield the mismatch of a clock offset: truth is interpolated at shifted stamps and the best shift searched."""
    rows = unique_rows(truth.stamps_ns)
    if not are_all(rows, len(truth)):
        truth = Trajectory(truth.stamps_ns[rows], truth.positions[rows], truth.quats_xyzw[rows])
    if min(len(estimate), len(truth)) < MIN_POSES:
        return
    step = int(np.median(np.diff(estimate.stamps_ns)))
    base = 0 if before is not None else int(truth.stamps_ns[0] - estimate.stamps_ns[0])
    reach = max(20 * step, 2 * NS_PER_S)
    best, least = base, np.inf
    while reach >= max(step // 500, 1000):
        for shift in np.linspace(best - reach, best + reach, OFFSET_STEPS + 1).astype(np.int64).tolist():
            value = _shifted(estimate, truth, shift)
            if value < least:
                best, least = shift, value
        reach = reach * 4 // OFFSET_STEPS
    if np.isfinite(least):
        same = best + _to_nearest_stamps(estimate, truth, best)
        best = same if _shifted(estimate, truth, same) <= AS_GOOD * least else best
        sentence = f"{LOOKS_WRONG} its stamps are {best / NS_PER_S:+.3f} s off, add this to them"
        yield Hypothesis(
            mismatch="time offset",
            sentence=sentence,
            disagreement=least,
            fitted=True,
            setting=f"time_offset_ns={best}",
        )


def _to_nearest_stamps(estimate: Trajectory, truth: Trajectory, shift: int) -> int:
    """Return what takes shifted stamps to the nearest of the truth, 0 where most are not as far from one."""
    stamps = estimate.stamps_ns + shift
    after = np.clip(np.searchsorted(truth.stamps_ns, stamps), 1, len(truth) - 1)
    around = np.stack((truth.stamps_ns[after - 1] - stamps, truth.stamps_ns[after] - stamps))
    left = around[np.abs(around).argmin(axis=0), np.arange(len(stamps))]
    middle = int(np.median(left))
    near = np.abs(left - middle) <= STAMP_NOISE_NS
    return middle if near.mean() > 0.5 else 0


def _shifted(estimate: Trajectory, truth: Trajectory, shift: int) -> float:
    """Return the disagreement if the estimate's stamps are moved; infinite where less than half have a truth."""
    first, last = np.searchsorted(estimate.stamps_ns, truth.stamps_ns[[0, -1]] - shift).tolist()
    if last - first < max(MIN_POSES, len(estimate) // 2):
        return float("inf")
    chosen = slice(first, last, max(1, (last - first) // 800))
    stamps = estimate.stamps_ns[chosen] + shift
    positions, before, after, share = _around(truth.stamps_ns, truth.positions, truth.quats_xyzw, stamps)
    quats = slerp(unit_quats(before), unit_quats(after), share)
    est = estimate.positions[chosen], unit_quats(estimate.quats_xyzw[chosen])
    return disagreement(case_of((positions, quats), est), est)


@jit
def _around(
    stamps: IntArray, positions: FloatArray, quats: FloatArray, wanted: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return interpolated positions `(M, 3)`, the quaternions `(M, 4)` before and after, and the share of the latter.

    Args:
        stamps: `(N,)` in order.
        positions: `(N, 3)`, metres.
        quats: `(N, 4)`.
        wanted: `(M,)` stamps in order, from the first to before the last; mostly evenly spaced.
    """
    found, share = np.empty((len(wanted), 3)), np.empty(len(wanted))
    before, after = np.empty((len(wanted), 4)), np.empty((len(wanted), 4))
    row, rows = 1, 0
    for i in range(len(wanted)):
        guess = min(row + rows, len(stamps) - 1)
        if not stamps[guess - 1] <= wanted[i] < stamps[guess]:
            guess = _first_later(stamps, wanted[i])
        row, rows = guess, guess - row
        begin = stamps[row - 1]
        share[i] = (wanted[i] - begin) / (stamps[row] - begin)
        for k in range(3):
            found[i, k] = positions[row - 1, k] + share[i] * (positions[row, k] - positions[row - 1, k])
        copy_row(quats[row - 1], before[i])
        copy_row(quats[row], after[i])
    return found, before, after, share


@jit
def _first_later(stamps: IntArray, wanted: int) -> int:
    """Return the row of the first stamp after a stamp."""
    low, high = 0, len(stamps)
    while low < high:
        middle = (low + high) // 2
        if stamps[middle] <= wanted:
            low = middle + 1
        else:
            high = middle
    return low
