"""Estimates, true poses and calls of a run in progress, as rows that grow with each message."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sfr_loc_map.calls.call_poses import estimates_of
from sfr_loc_map.calls.call_record import CallRecord, is_covariance_reported
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.calls.growing_calls import GrowingCalls
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.growing_rows import GrowingRows
from sfr_loc_map.io.truth.config import TrackedBodyConfig
from sfr_loc_map.io.truth.conversion import truth_of_rb
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.message_text import kind_of
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import COVARIANCE_SIZE, UPPER

_log = logging.getLogger(__name__)
MAX_STAGES = 64  #: Maximum number of stages. Bounded because the names come from the network.
POSE = [("stamp_ns", np.int64), ("position", np.float64, 3), ("quat", np.float64, 4)]
TRUE_POSE = [*POSE, ("variances", np.float64, 6)]
ESTIMATE = [*POSE, ("covariance", np.float64, COVARIANCE_SIZE)]
UNKNOWN_COVARIANCE = np.full(COVARIANCE_SIZE, np.nan)


class ReceivedRows:
    """The estimates, true poses and calls of a run, each in the order of their arrival.

    A true pose takes 112 bytes, an estimate with its covariance 232, the step of a localisation call 392, a call 96
    and the time of each of its stages 24 (docs/metrics.md, "Live").
    """

    def __init__(self, body: TrackedBodyConfig) -> None:
        """Start a run without rows. `body` is the tracked body of the true poses."""
        self.calls = GrowingCalls(MAX_STAGES)
        self._body = body
        self._estimates = GrowingRows(ESTIMATE)
        self._truth = GrowingRows(TRUE_POSE)
        self._covariance_ns = -1  # stamp of the last estimate with a published covariance
        self._warned = set[str]()  # logged warnings about the truth, with the numbers in them removed

    def add_estimate(
        self, stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float], covariance: FloatArray | None
    ) -> None:
        """Add an estimated pose of RB in DS, orientation and covariance `(6, 6)` in ROS order."""
        _check(stamp_ns, position, quat_xyzw)
        if not any(quat_xyzw):
            raise InputError(f"the estimate of stamp {stamp_ns} has no attitude: its quaternion is zero")
        triangle = UNKNOWN_COVARIANCE if covariance is None else covariance[UPPER]
        if is_covariance_reported(triangle[None])[0]:
            self._covariance_ns = stamp_ns
        self._estimates.add(stamp_ns, position, quat_xyzw, triangle)

    def add_truth(
        self, stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float], variances: FloatArray | None = None
    ) -> None:
        """Add a true pose of the tracked body in DS, with variances `(6,)`. A zero quaternion means a position only."""
        _check(stamp_ns, position, quat_xyzw)
        if len(self._truth) and any(quat_xyzw) != self._truth.all()["quat"][0].any():
            raise InputError(
                f"true pose of stamp {stamp_ns}: an attitude is required for all poses of the truth, or for none"
            )
        self._truth.add(stamp_ns, position, quat_xyzw, np.nan if variances is None else variances)

    def add_call(self, record: CallRecord) -> None:
        """Add a call, before or after its pose."""
        # the published covariance takes precedence, so the covariance in the call record is dropped
        if record.stamp_ns == self._covariance_ns:
            record = replace(record, covariance=None)
        self.calls.add(record)

    @property
    def has_estimates(self) -> bool:
        """Whether there is an estimate."""
        return len(self._estimates) > 0

    @property
    def messages(self) -> int:
        """Number of received poses, true poses and calls."""
        return self.poses + len(self.calls)

    @property
    def poses(self) -> int:
        """Number of received estimates and true poses."""
        return len(self._estimates) + len(self._truth)

    def truth(self) -> Truth | None:
        """Return the true poses as poses of RB; None before the first true pose."""
        if not len(self._truth):
            return None
        rows = self._truth.all()
        poses = Trajectory(rows["stamp_ns"], rows["position"], rows["quat"])
        return truth_of_rb(RecordedTruth(poses, "", rows["variances"]), self._body, self._warn_once)

    def _warn_once(self, text: str) -> None:
        """Log a warning about the truth unless the same text, possibly with other numbers, was logged in this run."""
        kind = kind_of(text)
        if kind not in self._warned:
            self._warned.add(kind)
            _log.warning(text)

    def estimates(self, stats: CallStats | None, *, is_under_way: bool = False) -> Estimates | None:
        """Return the estimates with the states and covariances of their calls.

        During a run, the calls of poses after the last call may still arrive. Whether these
        poses are lost or degraded therefore counts as known.
        """
        if not len(self._estimates):
            return None
        rows = self._estimates.all()
        trajectory = Trajectory(rows["stamp_ns"], rows["position"], rows["quat"])
        estimates = estimates_of(trajectory, stats, rows["covariance"])
        if stats is None or not is_under_way or not len(stats.localised_ns):
            return estimates
        is_awaited = rows["stamp_ns"] > stats.localised_ns.max()
        return replace(
            estimates,
            is_lost_known=estimates.is_lost_known | is_awaited,
            is_degraded_known=estimates.is_degraded_known | is_awaited,
        )


def _check(stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
    Trajectory(np.array([stamp_ns]), np.array([position], np.float64), np.array([quat_xyzw], np.float64))
