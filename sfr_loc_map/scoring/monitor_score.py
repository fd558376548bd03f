"""The score of a run from what comes over topics, without ROS.

The rows that came are kept and scored by the very functions that score files, so that a live score has the bits of the
score of a recording. A true pose takes 112 bytes, an estimate with its covariance 240, what the localiser says of its
step 400, a call 230 (docs/metrics.md, "While a run goes on").
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, PointImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import JUMP_BACK_NS, NS_PER_S
from sfr_loc_map.io.truth.config import RB_ITSELF, TrackedBody
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.metrics.association import COVARIANCE_SIZE, UPPER, Estimates
from sfr_loc_map.metrics.call_meter import METHOD
from sfr_loc_map.metrics.calls import Calls, stage_of
from sfr_loc_map.metrics.cloud_error import PairTruth, ScoredMap, score_map
from sfr_loc_map.metrics.config import MappingState, ScoreConfig
from sfr_loc_map.metrics.consistency import STEP_SIZE
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.records import Provenance
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.runs.calls import CallRecord, CallStats, estimates_of, is_covariance_reported
from sfr_loc_map.scoring.conversion import convention_mismatch
from sfr_loc_map.scoring.inputs import DriveToScore, Run, ScoreInputs
from sfr_loc_map.scoring.live_score import LiveRun, score_so_far

T = TypeVar("T")
MAX_STAGES = 16  #: Stages whose times are kept: their names come from the network.
MAX_KEPT = 2 * MAX_PAIRS  #: True points, poses, sets of pairs and clouds that are kept until the others come.
POSE = [("stamp_ns", np.int64), ("position", np.float64, 3), ("quat", np.float64, 4)]
TRUE_POSE = [*POSE, ("variances", np.float64, 6)]
ESTIMATE = [*POSE, ("covariance", np.float64, COVARIANCE_SIZE)]
STEP = [("row", np.int64), ("step", np.float64, STEP_SIZE)]
CALL: list[Any] = [("stamp_ns", np.int64), ("seconds", np.float64), ("state", "U16"), ("peak", np.float64)]
CALL += [("above_idle", np.float64), ("stages", np.float64, MAX_STAGES)]
COVARIANCE = [("row", np.int64), ("covariance", np.float64, COVARIANCE_SIZE)]
UNKNOWN_COVARIANCE = np.full(COVARIANCE_SIZE, np.nan)


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


class _CallRows(_Rows):
    """The calls of a run."""

    def __init__(self) -> None:
        super().__init__(CALL)
        self._stages = dict[str, int]()
        self._steps = _Rows(STEP)  # of the calls that report one, by the row of the call
        self._covariances = _Rows(COVARIANCE)  # likewise

    def add_call(self, record: CallRecord) -> None:
        stages = np.full(MAX_STAGES, np.nan)
        for figure, seconds in record.statistics.items():
            if (name := stage_of(figure)) and (name in self._stages or len(self._stages) < MAX_STAGES):
                stages[self._stages.setdefault(name, len(self._stages))] = seconds
        sizes = record.peak_rss_bytes, record.above_idle_bytes
        peaks = (np.nan if value is None else value for value in sizes)
        if record.step is not None:
            self._steps.add(len(self), record.step)
        if record.covariance is not None:
            self._covariances.add(len(self), record.covariance[UPPER])
        self.add(record.stamp_ns, record.processing_time_s, record.state, *peaks, stages)

    def stats(self) -> CallStats | None:
        """Return the calls as columns, None without a call."""
        if not len(self):
            return None
        covariance = self._column(self._covariances.all(), "covariance", COVARIANCE_SIZE)
        return CallStats(self._calls(), covariance, self._column(self._steps.all(), "step", STEP_SIZE))

    def _column(self, reported: NDArray[Any], name: str, width: int) -> FloatArray | None:
        """Return values `(N, width)` that some calls report, NaN for the others; None if no call reports one."""
        if not len(reported):
            return None
        values = np.full((len(self), width), np.nan)
        values[reported["row"]] = reported[name]
        return values

    def _calls(self) -> Calls:
        rows = self.all()
        stages = {name: rows["stages"][:, column] for name, column in self._stages.items()}
        figures = (rows["stamp_ns"], rows["seconds"], rows["state"].tolist(), rows["peak"], rows["above_idle"])
        return Calls(*figures, stages, memory_method=METHOD)


class _Latest(OrderedDict[int, T]):
    """The last values by stamp."""

    def __setitem__(self, stamp_ns: int, value: T) -> None:
        super().__setitem__(stamp_ns, value)
        while len(self) > MAX_KEPT:
            self.popitem(last=False)


class MapInputs:
    """Clouds, and the truth of their pairs, by stamp, until they can be scored."""

    def __init__(self) -> None:
        self.rig: StereoRig | None = None  # of the navigation cameras
        self.true_points = _Latest[PointImage]()  # `(H, W, 3)` of each pair, metres, LM
        self.poses = _Latest[Transform]()  # `T_lm_navsb` of each pair
        self.clouds = _Latest[PointCloud]()  # as published; the stamp is that of the last pair
        self.pair_stamps_ns = set[int]()  # of all mapping pairs that came, which maps have to hold
        self._mapped_until_ns = -1  # stamp of the last pair of the last map
        self._fusions = _Latest[CallRecord]()  # by the stamp of their cloud

    def add_pose(self, stamp_ns: int, T_lm_navsb: Transform) -> None:
        """Add the pose of a mapping pair."""
        self.poses[stamp_ns] = T_lm_navsb
        self.pair_stamps_ns.add(stamp_ns)

    def add_call(self, record: CallRecord) -> None:
        """Add a call; that of a fusion names the pairs of its cloud."""
        if record.state == MappingState.FUSED and record.pair_stamps_ns:
            self._fusions[record.stamp_ns] = record

    def take_complete(self) -> Iterator[tuple[PointCloud, list[PairTruth], int]]:
        """Yield, and forget, the clouds whose pairs and truth are known, with the truth of each pair.

        The third value is the number of pairs that came since the last map, which the map has to hold.
        """
        for stamp_ns in list(self.clouds):
            fusion = self._fusions.get(stamp_ns)
            if fusion is None or self.rig is None:
                continue
            wanted = fusion.pair_stamps_ns
            if not all(stamp in self.true_points and stamp in self.poses for stamp in wanted):
                continue
            truths = [PairTruth(self.true_points[s], self.poses[s] @ self.rig.T_sb_left, self.rig) for s in wanted]
            last_ns, begin_ns = max(wanted), self._mapped_until_ns
            expected = sum(begin_ns < stamp <= last_ns for stamp in self.pair_stamps_ns)
            self._mapped_until_ns = max(begin_ns, last_ns)
            yield replace(self.clouds.pop(stamp_ns), fused=fusion.is_fused), truths, max(expected, len(wanted))


class MonitorScore:
    """Collects poses, truth, clouds and calls, and scores them; `map_score` is of the last map that could be scored."""

    def __init__(self, config: ScoreConfig, limits: Limits | None, body: TrackedBody = RB_ITSELF) -> None:
        """Start a run, judged by limits if there are any; `body` is what the true poses are of."""
        self.map_inputs = MapInputs()
        self.limits = limits
        self._config, self._body = config, body
        self._latest_ns: dict[str, int] = {}
        self.restarts = 0  #: How often another time began a new run since the operator's reset.
        self.dropped = 0  #: Messages that were lost in transport or dropped.
        self.restart()

    def restart(self, kind: str = "", stamp_ns: int = 0) -> None:
        """Forget everything but the inputs of maps to come; `kind` is what has begun another run, at a stamp."""
        self.restarts = self.restarts + 1 if kind else 0
        end_ns = max(self._latest_ns.values(), default=0)
        self._ended_ns = {name: (ns, end_ns) for name, ns in self._latest_ns.items() if kind and name != kind}
        self._latest_ns = {kind: stamp_ns} if kind else {}
        self._estimates = _Rows(ESTIMATE)
        self._truth = _Rows(TRUE_POSE)
        self._calls = _CallRows()
        self._covariance_ns = -1  # stamp of the last estimate that was published with a covariance
        self.map_score: ScoredMap | None = None

    def is_late(self, kind: str, stamp_ns: int) -> bool:
        """Return whether a stamp is of the run before, which another kind has left; of results, which come later."""
        own_ns, end_ns = self._ended_ns.get(kind, (0, -1))  # what this kind had come to, and the run
        new_ns = max(self._latest_ns.values(), default=stamp_ns)
        late = kind in self._ended_ns and own_ns - JUMP_BACK_NS <= stamp_ns <= end_ns + JUMP_BACK_NS
        late = late and stamp_ns - new_ns > JUMP_BACK_NS
        if not late:
            self._ended_ns.pop(kind, None)
        return late

    def note_stamp(self, kind: str, stamp_ns: int) -> None:
        """Note a stamp of a kind in the present run."""
        self._latest_ns[kind] = max(self._latest_ns.get(kind, stamp_ns), stamp_ns)

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
        """Add a true pose of the tracked body in DS; a quaternion of zeros: its position alone. Variances `(6,)`."""
        _check(stamp_ns, position, quat_xyzw)
        if len(self._truth) and any(quat_xyzw) != self._truth.all()["quat"][0].any():
            raise InputError(f"true pose of stamp {stamp_ns}: all poses of a truth have an attitude, or none has one")
        self._truth.add(stamp_ns, position, quat_xyzw, np.nan if variances is None else variances)

    def add_call(self, record: CallRecord) -> None:
        """Add a call, before or after its pose; that of a fusion names the pairs of its cloud."""
        if record.stamp_ns == self._covariance_ns:  # the published covariance counts, and that of the call takes memory
            record = replace(record, covariance=None)
        self._calls.add_call(record)
        self.map_inputs.add_call(record)

    def score_maps(self) -> bool:
        """Score the clouds whose inputs are complete; the last one counts. Return whether there was one."""
        scored = False
        for cloud, truths, expected in self.map_inputs.take_complete():
            self.map_score = score_map(cloud, truths, self._config.map, expected_pairs=expected)
            scored = True
        return scored

    def result(
        self,
        provenance: Provenance | None = None,
        *,
        details: bool = True,
        in_flight_s: float = 0.0,
        image_stamps_ns: IntArray | None = None,
        contradiction: str | None = None,
    ) -> Score:
        """Return the score so far with the errors of its sub-trajectories; with details, what all plots are drawn from.

        While a run goes on, results of the last `in_flight_s` seconds are still expected and do not count as missing.
        `contradiction` is what the method of that name found.
        """
        stats = self._calls.stats()
        truth = self._given_truth()
        estimates = self._given_estimates(stats, is_under_way=in_flight_s > 0.0)
        drive = None
        if truth is not None and estimates is not None:
            drive = DriveToScore(estimates, truth, image_stamps_ns=image_stamps_ns)
        live = LiveRun(
            in_flight_ns=round(in_flight_s * NS_PER_S),
            details=details,
            contradiction=contradiction,
            scored_map=self.map_score,
            received=self.poses + len(self._calls),
            dropped=self.dropped,
            restarts=self.restarts,
            provenance=provenance,
        )
        pairs = np.array(sorted(self.map_inputs.pair_stamps_ns), np.int64)
        run = Run(ScoreInputs(), [] if stats is None else [stats], drive=drive, nav_stamps_ns=pairs)
        return score_so_far(run, live, self._config, self.limits)

    def contradiction(self) -> str | None:
        """Return the convention mismatch of estimate and truth so far, None without one; takes 0.1 s and more."""
        truth, estimates = self._given_truth(), self._given_estimates(None)
        if truth is None or estimates is None:
            return None
        return convention_mismatch(DriveToScore(estimates, truth), self._config)

    @property
    def poses(self) -> int:
        """Number of estimates and true poses so far."""
        return len(self._estimates) + len(self._truth)

    def _given_truth(self) -> Truth | None:
        if not len(self._truth):
            return None
        rows = self._truth.all()
        poses = Trajectory(rows["stamp_ns"], rows["position"], rows["quat"])
        return self._body.applied(poses, rows["variances"])

    def _given_estimates(self, stats: CallStats | None, *, is_under_way: bool = False) -> Estimates | None:
        """Return the estimates with what the calls report of them.

        While a run is under way, the calls of the poses after the last call may still come: these count as reported.
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
