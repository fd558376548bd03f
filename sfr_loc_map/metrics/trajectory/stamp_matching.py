"""Which stamps belong together: one to one, on integer nanoseconds (definitions: `association`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.modes import AssociationMode

AUTO_STAMPS = 16
"""Stamps of each kind in the common span that `auto` looks at."""


def unique_rows(stamps_ns: IntArray) -> NDArray[np.intp]:
    """Return the rows in order of their stamps; of rows with one stamp the last."""
    if len(stamps_ns) > 1 and not np.all(stamps_ns[1:] > stamps_ns[:-1]):
        order = np.argsort(stamps_ns, kind="stable")
        ordered = stamps_ns[order]
        return np.asarray(order[np.append(ordered[1:] != ordered[:-1], True)])
    return np.arange(len(stamps_ns), dtype=np.intp)


def are_all(rows: NDArray[np.intp], count: int) -> bool:
    """Tell whether rows are all of so many, in their order: then nothing needs to be copied."""
    return len(rows) == count and bool(np.all(rows[1:] > rows[:-1]))


def count_unordered(stamps_ns: IntArray) -> int:
    """Return how many stamps are earlier than one before them."""
    if len(stamps_ns) < 2:
        return 0
    return int(np.count_nonzero(stamps_ns[1:] < np.maximum.accumulate(stamps_ns)[:-1]))


def tolerance_ns(config: AssociationConfig) -> int:
    """Return the tolerance in nanoseconds."""
    return round(config.tolerance_s * NS_PER_S)


def decide_mode(est_stamps: IntArray, gt_stamps: IntArray, config: AssociationConfig) -> AssociationMode:
    """Return `match` or `interpolate` from stamps in order and without duplicates."""
    chosen = AssociationMode(config.truth)
    if chosen is not AssociationMode.AUTO:
        return chosen
    if not len(est_stamps) or not len(gt_stamps):
        return AssociationMode.MATCH
    low = max(est_stamps[0], gt_stamps[0]) - tolerance_ns(config)
    est, gt = est_stamps[np.searchsorted(est_stamps, low) :], gt_stamps[np.searchsorted(gt_stamps, low) :]
    if not len(est) or not len(gt):
        return AssociationMode.MATCH
    until = max(est[min(AUTO_STAMPS, len(est)) - 1], gt[min(AUTO_STAMPS, len(gt)) - 1])
    until = min(until, est[-1], gt[-1]) + tolerance_ns(config)
    est, gt = est[est <= until], gt[gt <= until]
    together = np.count_nonzero(_nearest(est, gt)[1] <= tolerance_ns(config))
    coincide = 4 * together >= min(len(est), len(gt))
    return AssociationMode.MATCH if coincide else AssociationMode.INTERPOLATE


def match_stamps(est_stamps: IntArray, gt_stamps: IntArray, tolerance: int) -> NDArray[np.intp]:
    """Return for each estimate the index of its truth, or -1; each truth is used once.

    Equal stamps first; then each estimate left over takes the nearest truth left over (the earlier of two); if several
    would take one truth, the nearest of them (the earliest of equals) does.
    """
    partner = np.full(len(est_stamps), -1, dtype=np.intp)
    if not len(est_stamps) or not len(gt_stamps):
        return partner
    index = np.minimum(np.searchsorted(gt_stamps, est_stamps), len(gt_stamps) - 1)
    equal = gt_stamps[index] == est_stamps
    partner[equal] = index[equal]
    free_est = np.flatnonzero(~equal)
    free_gt = np.setdiff1d(np.arange(len(gt_stamps)), index[equal], assume_unique=True) if len(free_est) else free_est
    if tolerance and len(free_est) and len(free_gt):
        nearest, difference = _nearest(est_stamps[free_est], gt_stamps[free_gt])
        candidates = np.flatnonzero(difference <= tolerance)
        candidates = candidates[np.argsort(difference[candidates], kind="stable")]
        _, first = np.unique(nearest[candidates], return_index=True)
        chosen = candidates[first]
        partner[free_est[chosen]] = free_gt[nearest[chosen]]
    return partner


def bracketed(
    est_stamps: IntArray, gt_stamps: IntArray, partner: NDArray[np.intp], max_gap: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the estimates between two true poses at most `max_gap` apart, and the index of the later of both."""
    left_over = np.flatnonzero(partner < 0)
    after = np.searchsorted(gt_stamps, est_stamps[left_over])
    inside = (after > 0) & (after < len(gt_stamps))
    left_over, after = left_over[inside], after[inside]
    near = gt_stamps[after] - gt_stamps[after - 1] <= max_gap
    return left_over[near], after[near]


def _nearest(stamps: IntArray, among: IntArray) -> tuple[NDArray[np.intp], IntArray]:
    """Return the index of the nearest of `among` (sorted, not empty) for each stamp, and the distance."""
    after = np.minimum(np.searchsorted(among, stamps), len(among) - 1)
    before = np.maximum(after - 1, 0)
    to_before, to_after = np.abs(stamps - among[before]), np.abs(among[after] - stamps)
    return np.where(to_before <= to_after, before, after), np.minimum(to_before, to_after)
