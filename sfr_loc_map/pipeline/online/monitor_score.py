"""The score of a run from what comes over topics, without ROS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sfr_loc_map.constants import LOST_VARIANCE
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.build import ScoreParts, build_score
from sfr_loc_map.metrics.calls.resource_score import score_calls
from sfr_loc_map.metrics.cloud.cloud_error import ScoredMap, score_map
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.score import Provenance, Score
from sfr_loc_map.metrics.trajectory.online_score import LiveTrajectoryScore
from sfr_loc_map.metrics.verdicts.limits import Limits
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.online.call_ring import CallRing
from sfr_loc_map.pipeline.online.map_inputs import MapInputs
from sfr_loc_map.pipeline.online.stamp_order import jumped_back

MAX_CALLS = 100_000
"""Calls that times and memory are summarised over, the last ones."""


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
        self._trajectory = LiveTrajectoryScore(config.trajectory)
        self._calls = CallRing(MAX_CALLS)
        self.map_score: ScoredMap | None = None
        self._estimates = self._truths = 0
        self._latest_ns: dict[str, int] = {}

    def restart(self) -> None:
        """Forget everything but the inputs of maps to come."""
        self._trajectory = LiveTrajectoryScore(self._config.trajectory)
        self._calls.clear()
        self.map_score = None
        self._estimates = self._truths = 0
        self._latest_ns.clear()

    def jumped_back(self, kind: str, stamp_ns: int) -> bool:
        """Tell whether a stamp lies so far behind the latest one of its kind that a new run must have begun."""
        latest_ns = self._latest_ns.get(kind, stamp_ns)
        self._latest_ns[kind] = max(latest_ns, stamp_ns)
        return jumped_back(latest_ns, stamp_ns)

    def add_estimate(
        self, stamp_ns: int, position: tuple[float, ...], quat_xyzw: tuple[float, ...], covariance: FloatArray | None
    ) -> None:
        """Add an estimated pose of RB in DS; see `LiveTrajectoryScore.add_estimate`."""
        lost = covariance is not None and bool((np.diagonal(covariance) >= LOST_VARIANCE).all())
        self._trajectory.add_estimate(stamp_ns, position, quat_xyzw, covariance, lost)
        self._estimates += 1

    def add_truth(self, stamp_ns: int, position: tuple[float, ...], quat_xyzw: tuple[float, ...]) -> None:
        """Add a true pose of RB in DS."""
        self._trajectory.add_truth(stamp_ns, position, quat_xyzw)
        self._truths += 1

    def add_call(self, record: CallRecord) -> None:
        """Add a call; calls of the mapper say which pairs a cloud is made of."""
        self._calls.add(record)
        if record.state == TrackingState.DEGRADED or record.step is not None:
            self._trajectory.note_call(record.stamp_ns, record.step, degraded=record.state == TrackingState.DEGRADED)
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
        scored_map = self.map_score
        if scored_map is not None and not details:
            scored_map = replace(scored_map, details=None)
        parts = ScoreParts(
            calls=[score_calls(self._calls.calls(), details=details)] if len(self._calls) else [],
            trajectory=self._trajectory.result(details=details) if self._estimates and self._truths else None,
            map=scored_map,
            provenance=provenance,
        )
        return build_score(parts, self._limits)


def warm_up(config: ScoreConfig) -> None:
    """Load all compiled code of the trajectory score."""
    live = LiveTrajectoryScore(config.trajectory)
    for stamp in range(3):
        live.add_truth(stamp, (float(stamp), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        live.add_estimate(stamp, (float(stamp), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), np.eye(6))
    live.result()
