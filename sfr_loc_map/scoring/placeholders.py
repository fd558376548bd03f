"""Poses that are not measured: constant attitudes of an estimate, and a truth that stands still or repeats poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.truth.pose_checks import SHORTEST_M, has_constant_attitude
from sfr_loc_map.metrics.completeness.copies import resolution_of

MOVED_M = 1.0  #: Extent of an estimate, m, from which on a stationary truth is reported.
STATIONARY_SHARE = 0.01  #: Largest extent of a stationary truth, as a fraction of the extent of the estimate.
MAX_HELD = 0.1  #: Largest fraction of the estimated path without a warning at which the truth repeats a pose.


def placeholder_warnings(estimate: Trajectory, truth: Trajectory) -> Iterator[str]:
    """Yield a warning if the attitudes of the estimate, or poses of the truth, are placeholders."""
    if has_constant_attitude(estimate):
        yield (
            "all poses of the estimate have the same attitude although its path turns: its attitudes are placeholders, "
            "so that attitude errors, and position errors of re-based poses, are not those of the method"
        )
    held = held_share(truth, estimate)
    if held > MAX_HELD:
        yield (
            f"the truth repeats a pose exactly while the estimate covers {100.0 * held:.3g} % of its path: the truth "
            "was held while its source was lost or slower than its stamps; remove the repeated poses"
        )


def stationary_truth_warnings(estimate: Trajectory, truth: Trajectory) -> Iterator[str]:
    """Yield a warning if the true positions do not change although the estimate moves."""
    estimated_m = _extent_m(estimate)
    true_m = _extent_m(truth)
    if estimated_m > MOVED_M and true_m < STATIONARY_SHARE * estimated_m:
        yield (
            f"the ground truth moves by {true_m:.3g} m, the estimate by {estimated_m:.3g} m: verify that the ground "
            "truth tracks the rover"
        )


def _extent_m(poses: Trajectory) -> float:
    """Return the largest extent of the positions along an axis, m; 0 without poses."""
    return float(np.ptp(poses.positions, axis=0).max()) if len(poses) else 0.0


def held_share(truth: Trajectory, estimate: Trajectory) -> float:
    """Return the fraction of the estimated path that is covered while the truth repeats a pose exactly.

    Each run of equal true poses counts by the distance between the estimates at its ends, which is small for a
    stationary vehicle. The estimates are interpolated.
    """
    if min(len(truth), len(estimate)) < 2:
        return 0.0
    order, of_estimate = (np.argsort(poses.stamps_ns, kind="stable") for poses in (truth, estimate))
    poses = np.concatenate((truth.positions, truth.quats_xyzw), axis=1)[order]
    is_held = (poses[1:] == poses[:-1]).all(axis=1)
    if not is_held.any():
        return 0.0
    first_ns = int(truth.stamps_ns[order[0]])
    times = (truth.stamps_ns[order] - first_ns).astype(np.float64)
    known = (estimate.stamps_ns[of_estimate] - first_ns).astype(np.float64)
    at_truth = np.column_stack([np.interp(times, known, axis) for axis in estimate.positions[of_estimate].T])
    ends = np.append(np.append(0, np.flatnonzero(~is_held) + 1), len(times))  # of the runs of equal poses
    distances_m = np.linalg.norm(at_truth[ends[1:] - 1] - at_truth[ends[:-1]], axis=1)
    # coarse positions are equal without having been held
    held_m = float(distances_m[distances_m > 2.0 * resolution_of(truth.positions)].sum())
    path_m = float(np.linalg.norm(np.diff(at_truth, axis=0), axis=1).sum())
    return held_m / path_m if held_m > SHORTEST_M else 0.0
