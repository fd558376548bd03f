"""The score of a run from what comes over topics, without ROS: what the monitor node knows."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sfr_loc_map.constants import JUMP_BACK_NS, LOST_VARIANCE
from sfr_loc_map.geometry.arrays import FloatArray, PointImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.metrics.cloud_error import score_map
from sfr_loc_map.metrics.cloud_truth import PairTruth
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.online_score import LiveTrajectoryScore
from sfr_loc_map.metrics.resource_score import Calls, merge_parts, score_calls, stage_of
from sfr_loc_map.metrics.results import build_score
from sfr_loc_map.pipeline.call_record import CallRecord

MAX_CALLS = 100_000
"""Calls that times and memory are summarised over, the last ones."""
MOST_STATES, MOST_STAGES = 100, 16
"""Words of calls that are told apart, and stages whose times are kept: a stranger may invent more."""
MAX_TRUTHS = 2 * MAX_PAIRS
"""True point images and poses kept for clouds to come."""


@dataclass(slots=True)
class _MapInputs:
    """What a map score is made of, until all of it is there."""

    rig: StereoRig | None = None
    points: OrderedDict[int, PointImage] = field(default_factory=OrderedDict)
    poses: OrderedDict[int, Transform] = field(default_factory=OrderedDict)
    mapped_ns: list[int] = field(default_factory=list)
    sets_ns: OrderedDict[int, list[int]] = field(default_factory=OrderedDict)
    clouds: OrderedDict[int, PointCloud] = field(default_factory=OrderedDict)


class CallRing:
    """The last calls, in arrays that are there from the start: what a long run keeps does not grow."""

    def __init__(self, room: int) -> None:
        """Make room for so many calls."""
        self._figures = np.full((3, room), np.nan)  # seconds, peak, above idle; written to, so that memory is taken now
        self._stamps_ns, self._states = np.full(room, -1, np.int64), np.full(room, -1, np.int16)
        self._names: list[str] = []
        self._stages: dict[str, FloatArray] = {}
        self._given = 0

    def __len__(self) -> int:
        """Return how many are kept."""
        return min(self._given, len(self._states))

    def add(self, record: CallRecord) -> None:
        """Add a call; the oldest goes if there is no room."""
        at = self._given % len(self._states)
        self._stamps_ns[at], self._states[at] = record.stamp_ns, self._state(record.state)
        peaks = (np.nan if value is None else value for value in (record.peak_rss_bytes, record.above_idle_bytes))
        self._figures[:, at] = (record.processing_time_s, *peaks)
        for seconds in self._stages.values():
            seconds[at] = np.nan
        for figure, value in record.statistics.items():
            if (name := stage_of(figure)) and (kept := self._stage(name)) is not None:
                kept[at] = value
        self._given += 1

    def clear(self) -> None:
        """Forget all calls."""
        self._given = 0
        self._stages.clear()

    def calls(self) -> Calls:
        """Return them in the order in which they came."""
        order = np.arange(self._given - len(self), self._given) % len(self._states)
        seconds, peak, above = self._figures[:, order]
        names = np.array(self._names, object)
        stages = {name: kept[order] for name, kept in self._stages.items()}
        return Calls(self._stamps_ns[order], seconds, names[self._states[order]].tolist(), peak, above, stages)

    def _stage(self, name: str) -> FloatArray | None:
        """Return the times of a stage, None if there are too many stages already."""
        if name not in self._stages and len(self._stages) < MOST_STAGES:
            self._stages[name] = np.full(len(self._states), np.nan)
        return self._stages.get(name)

    def _state(self, name: str) -> int:
        """Return the number of a state; a stranger may invent words, so there is an end to them."""
        if name not in self._names:
            if len(self._names) == MOST_STATES:
                return MOST_STATES - 1
            self._names.append(name)
        return self._names.index(name)


class MonitorScore:
    """Collects poses, truth, clouds and calls, and scores them."""

    def __init__(self, config: ScoreConfig, limits: Limits | None) -> None:
        """Start a run.

        Args:
            config: Settings of the score.
            limits: Limits to judge by.
        """
        self._config, self._limits = config, limits
        self._trajectory = LiveTrajectoryScore(config.trajectory)
        self._calls = CallRing(MAX_CALLS)
        self._map = _MapInputs()
        self._map_score: dict[str, Any] = {}
        self._estimates = self._truths = 0
        self._latest_ns: dict[str, int] = {}

    @property
    def rig(self) -> StereoRig | None:
        """Rig of the navigation cameras, None until it is known."""
        return self._map.rig

    def restart(self) -> None:
        """Forget everything but the rig and what belongs to maps to come."""
        self._trajectory = LiveTrajectoryScore(self._config.trajectory)
        self._calls.clear()
        self._map_score = {}
        self._estimates = self._truths = 0
        self._latest_ns.clear()

    def goes_back(self, kind: str, stamp_ns: int) -> bool:
        """Tell whether a stamp lies so far behind the last one of its kind that a new run must have begun."""
        latest = self._latest_ns.get(kind, stamp_ns)
        self._latest_ns[kind] = max(latest, stamp_ns)
        return latest - stamp_ns > JUMP_BACK_NS

    def add_estimate(
        self, stamp_ns: int, position: tuple[float, ...], quat_xyzw: tuple[float, ...], covariance: FloatArray
    ) -> None:
        """Add an estimated pose of RB in DS; see `LiveTrajectoryScore.add_estimate`."""
        lost = bool((np.diagonal(covariance) >= LOST_VARIANCE).all())
        self._trajectory.add_estimate(stamp_ns, position, quat_xyzw, covariance, lost)
        self._estimates += 1

    def add_truth(self, stamp_ns: int, position: tuple[float, ...], quat_xyzw: tuple[float, ...]) -> None:
        """Add a true pose of RB in DS."""
        self._trajectory.add_truth(stamp_ns, position, quat_xyzw)
        self._truths += 1

    def add_call(self, record: CallRecord) -> None:
        """Add a call; calls of the mapper say which pairs a cloud is made of."""
        self._calls.add(record)
        if record.state == "mapped":
            self._map.mapped_ns.append(record.stamp_ns)
        elif record.state == "fused":
            _keep(self._map.sets_ns, record.stamp_ns, self._map.mapped_ns)
            self._map.mapped_ns = []

    def set_rig(self, rig: StereoRig) -> None:
        """Set the rig of the navigation cameras."""
        self._map.rig = rig

    def add_true_points(self, stamp_ns: int, points: PointImage) -> None:
        """Add the true points `(H, W, 3)` of a pair, metres, LM."""
        _keep(self._map.points, stamp_ns, points)

    def add_pose(self, stamp_ns: int, T_lm_navsb: Transform) -> None:
        """Add the pose of a pair."""
        _keep(self._map.poses, stamp_ns, T_lm_navsb)

    def add_cloud(self, stamp_ns: int, cloud: PointCloud) -> None:
        """Add a fused cloud; its stamp is that of its last pair."""
        _keep(self._map.clouds, stamp_ns, cloud)

    def score_maps(self) -> bool:
        """Score the clouds for which everything is there; the last one counts. Return whether there was one.

        Raises:
            SfrError: If a cloud does not fit its truth; it is dropped.
        """
        parts, scored = self._map, False
        for stamp_ns in list(parts.clouds):
            stamps = parts.sets_ns.get(stamp_ns)
            truths = [self._truth_of(stamp) for stamp in stamps or ()]
            known = [truth for truth in truths if truth is not None]
            if stamps is None or len(known) < len(stamps):
                continue
            cloud = parts.clouds.pop(stamp_ns)
            self._map_score = score_map(cloud, known, self._config.map, fused=len(known) > 1)
            scored = True
        return scored

    def result(self, *, details: bool = True) -> dict[str, Any]:
        """Return the score so far (schema of the suite), without provenance; with details if wanted."""
        parts = [score_calls(self._calls.calls(), details=details)] if len(self._calls) else []
        if self._estimates and self._truths:
            parts.append(self._trajectory.result(details=details))
        if self._map_score:
            parts.append(self._map_score if details else {"map": self._map_score["map"]})
        return build_score(merge_parts(*parts), limits=self._limits)

    def _truth_of(self, stamp_ns: int) -> PairTruth | None:
        rig, points, pose = self._map.rig, self._map.points.get(stamp_ns), self._map.poses.get(stamp_ns)
        if rig is None or points is None or pose is None:
            return None
        return PairTruth(points, pose @ rig.T_sb_left, rig)


def warm_up(config: ScoreConfig) -> None:
    """Load all machine code of the trajectory score."""
    live = LiveTrajectoryScore(config.trajectory)
    for stamp in range(3):
        live.add_truth(stamp, (float(stamp), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        live.add_estimate(stamp, (float(stamp), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), np.eye(6))
    live.result()


def _keep(kept: OrderedDict[int, Any], stamp_ns: int, value: Any) -> None:  # noqa: ANN401 - any of the map's inputs
    kept[stamp_ns] = value
    while len(kept) > MAX_TRUTHS:
        kept.popitem(last=False)
