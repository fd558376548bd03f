"""States, covariances and steps of the poses of a run, from the calls of the run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.calls.call_record import first_reported
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.frames.association import Estimates, nearness_ns
from sfr_loc_map.metrics.frames.covariance import lost_by_covariance
from sfr_loc_map.stamp_pairing import nearest_stamps


def estimates_of(trajectory: Trajectory, stats: CallStats | None, covariance: FloatArray | None = None) -> Estimates:
    """Return the poses with the states, covariances and steps that calls and published covariances report.

    `covariance` `(N, 21)` has the upper triangles that were published with the poses. Without a published covariance,
    the covariance of a pose is that of its call (`is_covariance_reported`). A pose is lost if its covariance or the
    state of its call reports a loss, or if its call initialises again after the first tracked pose.
    """
    states = np.full(len(trajectory), "", object)
    steps = of_calls = None
    if stats is not None:
        stats = with_stamps_of_poses(stats, trajectory.stamps_ns)
        rows = stats.localised_rows(trajectory.stamps_ns)
        states = np.array([*stats.calls.states, ""], object)[rows]
        steps = _steps_between(trajectory.stamps_ns, stats, rows)
        of_calls = _values_at(stats.covariance, rows)
    covariance = first_reported(covariance, of_calls)
    lost = (states == TrackingState.LOST) | initialises_again(states, trajectory.stamps_ns)
    degraded = states == TrackingState.DEGRADED
    is_known = np.asarray(states != "", np.bool_)
    is_lost_known = is_known
    if covariance is not None:
        lost = lost | lost_by_covariance(covariance)
        is_lost_known = is_known | np.isfinite(covariance).all(axis=1)
    estimates = Estimates.of(trajectory, lost, degraded, covariance, steps)
    return replace(estimates, is_lost_known=is_lost_known, is_degraded_known=is_known)


def with_stamps_of_poses(stats: CallStats, stamps_ns: IntArray) -> CallStats:
    """Return calls of a localiser in which the call of each pose has the stamp of the pose, one of `stamps_ns` `(N,)`.

    The call of a pose is the nearest call within the tolerance for stamps of one image (`nearness_ns`), which is the
    smaller of the tolerances for poses and for calls. A call with the stamp of a pose does not belong to another pose.
    """
    called_ns, own_ns = np.unique(stats.localised_ns), np.unique(stamps_ns)
    if not len(called_ns) or not len(own_ns):
        return stats
    place, apart_ns = nearest_stamps(own_ns, called_ns)
    tolerance_ns = min(nearness_ns(called_ns), nearness_ns(own_ns))
    is_moved = (apart_ns <= tolerance_ns) & ~np.isin(called_ns, own_ns)[place]
    if not is_moved.any():
        return stats
    pose_ns = called_ns.copy()
    pose_ns[place[is_moved]] = own_ns[is_moved]
    given_ns, is_localisation = stats.calls.stamps_ns, stats.calls.is_localisation
    moved_ns = given_ns.copy()
    moved_ns[is_localisation] = pose_ns[np.searchsorted(called_ns, given_ns[is_localisation])]
    return replace(stats, calls=replace(stats.calls, stamps_ns=moved_ns))


def initialises_again(states: NDArray[np.object_], stamps_ns: IntArray) -> Mask:
    """Return which poses `(N,)` are initialised after a tracked or degraded pose: the motion in between is unknown."""
    is_tracked = np.isin(states, (TrackingState.TRACKING, TrackingState.DEGRADED))
    if not is_tracked.any():
        return np.zeros(len(states), np.bool_)
    return np.asarray((states == TrackingState.INITIALISING) & (stamps_ns > stamps_ns[is_tracked].min()))


def _steps_between(stamps_ns: IntArray, stats: CallStats, rows: NDArray[np.intp]) -> FloatArray | None:
    """Return the steps `(N, 48)` to poses from the rows of their calls; NaN if the previous pose is missing."""
    steps = _values_at(stats.steps, rows)
    if steps is None or stats.steps is None:
        return None
    has_step = stats.calls.is_localisation & np.isfinite(stats.steps).all(axis=1)
    stepped_ns = np.unique(stats.calls.stamps_ns[has_step])
    own_ns = np.unique(stamps_ns)
    # A pose between own_ns[i] and own_ns[i + 1] is missing if another step than that to own_ns[i + 1] ends there.
    steps_until = np.searchsorted(stepped_ns, own_ns, "right")
    has_gap = np.diff(steps_until) > np.isin(own_ns[1:], stepped_ns)
    steps[np.isin(stamps_ns, own_ns[1:][has_gap])] = np.nan
    return steps


def _values_at(values: FloatArray | None, rows: NDArray[np.intp]) -> FloatArray | None:
    """Return rows of an array `(N, K)`; the row -1 is NaN."""
    return None if values is None else np.vstack((values, np.full(values.shape[1], np.nan)))[rows]
