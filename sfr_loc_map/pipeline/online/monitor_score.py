"""The score of a run from what comes over topics, without ROS.

The rows that came are kept and scored by the very functions that score files, so that a live score has the bits of the
score of a recording. A true pose takes 64 bytes, an estimate with its covariance 240, what the localiser says of its
step 240 (docs/metrics.md, "While a run goes on").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import is_plausible_pose
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import LOST_VARIANCE
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.association import COVARIANCE_SIZE, UPPER, Estimates, unique_rows
from sfr_loc_map.metrics.calls import score_calls
from sfr_loc_map.metrics.cloud_error import ScoredMap, score_map
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.consistency import STEP_SIZE
from sfr_loc_map.metrics.limits import Limits, build_score
from sfr_loc_map.metrics.score import Provenance, Score
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.online.call_ring import CallRing
from sfr_loc_map.pipeline.online.map_inputs import MapInputs
from sfr_loc_map.pipeline.online.stamp_order import jumped_back

MAX_CALLS = 100_000
"""Calls that times and memory are summarised over, the last ones."""
POSE = [("stamp_ns", np.int64), ("position", np.float64, 3), ("quat", np.float64, 4)]
ESTIMATE = [*POSE, ("covariance", np.float64, COVARIANCE_SIZE), ("lost", np.bool_)]
STEP = [("stamp_ns", np.int64), ("step", np.float64, STEP_SIZE), ("degraded", np.bool_), ("known", np.bool_)]
UNKNOWN_COVARIANCE, UNKNOWN_STEP = np.full(COVARIANCE_SIZE, np.nan), np.full(STEP_SIZE, np.nan)


class _Rows:
    """Rows that are added one by one; memory that no row has been written to is not resident."""

    def __init__(self, kind: DTypeLike) -> None:
        self._array: NDArray[Any] = np.empty(1024, np.dtype(kind, align=True))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, *row: object) -> None:
        if self._count == len(self._array):
            longer = np.empty(2 * self._count, self._array.dtype)
            longer[: self._count] = self._array
            self._array = longer
        self._array[self._count] = row
        self._count += 1

    def all(self) -> NDArray[Any]:
        """Return a view that holds until the next row."""
        return self._array[: self._count]


class MonitorScore:
    """Collects poses, truth, clouds and calls, and scores them.

    Attributes:
        map_inputs: What the map scores to come are made of.
        map_score: Of the last map that could be scored, None before.
    """

    def __init__(self, config: ScoreConfig, limits: Limits | None) -> None:
        """Start a run.

        Args:
            config: Settings of the score.
            limits: Limits to judge by.
        """
        self.map_inputs = MapInputs()
        self._config, self._limits = config, limits
        self._calls = CallRing(MAX_CALLS)
        self.restart()

    def restart(self) -> None:
        """Forget everything but the inputs of maps to come."""
        self._estimates, self._truth, self._steps = _Rows(ESTIMATE), _Rows(POSE), _Rows(STEP)
        self._calls.clear()
        self.map_score: ScoredMap | None = None
        self._latest_ns: dict[str, int] = {}

    def jumped_back(self, kind: str, stamp_ns: int) -> bool:
        """Tell whether a stamp lies so far behind the latest one of its kind that a new run must have begun."""
        latest_ns = self._latest_ns.get(kind, stamp_ns)
        self._latest_ns[kind] = max(latest_ns, stamp_ns)
        return jumped_back(latest_ns, stamp_ns)

    def add_estimate(
        self, stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float], covariance: FloatArray | None
    ) -> None:
        """Add an estimated pose of RB in DS.

        Args:
            stamp_ns: Its stamp.
            position: `(3,)`, metres.
            quat_xyzw: `(4,)`, as in ROS messages.
            covariance: `(6, 6)` in ROS order, None where not known.

        Raises:
            GeometryError: If the pose is not finite, absurd or the quaternion not of unit length.
        """
        _check(stamp_ns, position, quat_xyzw)
        lost = covariance is not None and bool((np.diagonal(covariance) >= LOST_VARIANCE).all())
        triangle = UNKNOWN_COVARIANCE if covariance is None else covariance[UPPER]
        self._estimates.add(stamp_ns, position, quat_xyzw, triangle, lost)

    def add_truth(self, stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """Add a true pose of RB in DS.

        Raises:
            GeometryError: As `add_estimate`.
        """
        _check(stamp_ns, position, quat_xyzw)
        self._truth.add(stamp_ns, position, quat_xyzw)

    def add_call(self, record: CallRecord) -> None:
        """Add a call, before or after its pose; calls of the mapper say which pairs a cloud is made of."""
        self._calls.add(record)
        degraded, known = record.state == TrackingState.DEGRADED, record.step is not None
        if degraded or known:
            self._steps.add(record.stamp_ns, record.step if known else UNKNOWN_STEP, degraded, known)
        self.map_inputs.add_call(record)

    def score_maps(self) -> bool:
        """Score the clouds whose inputs are complete; the last one counts. Return whether there was one.

        Raises:
            SfrError: If a cloud does not fit its truth; it is dropped.
        """
        scored = False
        for cloud, truths in self.map_inputs.take_complete():
            self.map_score = score_map(cloud, truths, self._config.map)
            scored = True
        return scored

    def result(self, provenance: Provenance | None = None, *, details: bool = True) -> Score:
        """Return the score so far.

        Args:
            provenance: What it is made of.
            details: Whether what figures are drawn from is wanted.
        """
        scored_map, trajectory = self.map_score, None
        if scored_map is not None and not details:
            scored_map = replace(scored_map, details=None)
        if len(self._estimates) and len(self._truth):
            rows = self._truth.all()
            truth = Trajectory(rows["stamp_ns"], rows["position"], rows["quat"])
            config = self._config.trajectory
            trajectory = score_trajectory(self._given_estimates(), truth, config, details=details, under_way=True)
        return build_score(
            Score(provenance=provenance, verdicts=()),
            self._limits,
            trajectory=trajectory,
            map=scored_map,
            calls=[score_calls(self._calls.calls(), details=details)] if len(self._calls) else [],
        )

    def _given_estimates(self) -> Estimates:
        """Return the estimates with what the calls of their stamps said; of several calls the last counts."""
        rows, said = self._estimates.all(), self._steps.all()
        trajectory = Trajectory(rows["stamp_ns"], rows["position"], rows["quat"])
        covariance = None if np.isnan(rows["covariance"]).all() else rows["covariance"]
        if not len(said):
            return Estimates.of(trajectory, rows["lost"], covariance=covariance)
        last = unique_rows(said["stamp_ns"])
        stamps = said["stamp_ns"][last]
        at = np.minimum(np.searchsorted(stamps, rows["stamp_ns"]), len(stamps) - 1)
        found = np.flatnonzero(stamps[at] == rows["stamp_ns"])
        of_found = last[at[found]]
        degraded, steps = np.zeros(len(rows), np.bool_), None
        degraded[found] = said["degraded"][of_found]
        if said["known"][of_found].any():
            steps = np.full((len(rows), STEP_SIZE), np.nan)
            steps[found] = said["step"][of_found]
        return Estimates.of(trajectory, rows["lost"], degraded, covariance, steps)


def _check(stamp_ns: int, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
    if not is_plausible_pose(position, quat_xyzw):
        Trajectory(np.array([stamp_ns]), np.array([position], np.float64), np.array([quat_xyzw], np.float64))


def warm_up(config: ScoreConfig) -> None:
    """Load all compiled code of the trajectory score."""
    live = MonitorScore(config, None)
    for stamp in range(3):
        pose = (float(stamp), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
        live.add_truth(stamp, *pose)
        live.add_estimate(stamp, *pose, np.eye(6))
        live.add_call(CallRecord(stamp, 0.0, TrackingState.DEGRADED, None, None, step=np.zeros(STEP_SIZE)))
    live.result()
