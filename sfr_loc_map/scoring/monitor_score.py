"""The score of a run from received messages, without ROS.

The received rows are kept and scored by the functions that score files, so that the figures of a live score are
bit-identical to those of a recording. The finding about the conventions may differ, because the diagnosis has no
rig and is repeated only when the poses have grown by a fifth. A true pose takes 112 bytes, an estimate with its
covariance 232, the step of a localisation call 392, and a call 224 (docs/metrics.md, "Live").
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from sfr_loc_map.calls.call_record import CallRecord, is_covariance_reported
from sfr_loc_map.calls.call_stats import CallStats, estimates_of
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, PointImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.truth.config import RB_ITSELF, TrackedBodyConfig
from sfr_loc_map.io.truth.conversion import truth_of_rb
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.metrics.calls.call_meter import METHOD
from sfr_loc_map.metrics.calls.call_score import Calls, stage_of
from sfr_loc_map.metrics.completeness.expected_items import with_unmapped_pairs
from sfr_loc_map.metrics.config import MappingState, ScoreConfig
from sfr_loc_map.metrics.errors.cloud_error import PairTruth, score_map
from sfr_loc_map.metrics.errors.consistency import STEP_SIZE
from sfr_loc_map.metrics.frames.association import COVARIANCE_SIZE, UPPER, Estimates
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.scoring.conversion import ConventionFinding, convention_mismatch
from sfr_loc_map.scoring.inputs import DriveToScore, Run, ScoreInputs
from sfr_loc_map.scoring.live_maps import LiveMaps
from sfr_loc_map.scoring.live_score import ENDED, LiveRun, Received, score_so_far

T = TypeVar("T")
MAX_STAGES = 16  #: Maximum number of stages. Bounded because the names come from the network.
DIAGNOSED_GROWTH = 1.2  #: Growth of the number of poses after which a diagnosis is repeated.
MAX_KEPT = 2 * MAX_PAIRS  #: Maximum number of true points, poses and clouds that wait for their counterparts.
POSE = [("stamp_ns", np.int64), ("position", np.float64, 3), ("quat", np.float64, 4)]
TRUE_POSE = [*POSE, ("variances", np.float64, 6)]
ESTIMATE = [*POSE, ("covariance", np.float64, COVARIANCE_SIZE)]
STEP = [("row", np.int64), ("step", np.float64, STEP_SIZE)]
CALL: list[Any] = [("stamp_ns", np.int64), ("seconds", np.float64), ("state", "U16"), ("peak", np.float64)]
CALL += [("above_idle", np.float64), ("stages", np.float64, MAX_STAGES)]
COVARIANCE = [("row", np.int64), ("covariance", np.float64, COVARIANCE_SIZE)]
UNKNOWN_COVARIANCE = np.full(COVARIANCE_SIZE, np.nan)


class _Rows:
    """Rows that are added one by one. Memory of unused rows is not resident."""

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
        """Return a view that is valid until the next row is added."""
        return self._array[: self._count]


class _CallRows(_Rows):
    """The calls of a run."""

    def __init__(self) -> None:
        super().__init__(CALL)
        self._stages = dict[str, int]()
        self._steps = _Rows(STEP)  # steps of the calls that report one, with the row of the call
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
        """Return the calls as columns; None if there are no calls."""
        if not len(self):
            return None
        covariance = self._column(self._covariances.all(), "covariance", COVARIANCE_SIZE)
        return CallStats(self._calls(), covariance, self._column(self._steps.all(), "step", STEP_SIZE))

    def _column(self, reported: NDArray[Any], name: str, width: int) -> FloatArray | None:
        """Return the values `(N, width)` that calls report, NaN for other calls; None if no call reports one."""
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
    """The most recently set values; the keys are stamps."""

    def __setitem__(self, stamp_ns: int, value: T) -> None:
        super().__setitem__(stamp_ns, value)
        while len(self) > MAX_KEPT:
            self.popitem(last=False)


class MapInputs:
    """Clouds and the truth of their pairs by stamp, kept until they can be scored."""

    def __init__(self) -> None:
        self.rig: StereoRig | None = None  #: Rig of the navigation cameras; None before their camera_info.
        self._true_points = _Latest[PointImage]()  # `(H, W, 3)` of each pair, metres, LM
        self._poses = _Latest[Transform]()  # `T_lm_navsb` of each pair
        self._clouds = _Latest[PointCloud]()  # clouds as published, with the stamp of the last pair
        self._fusions = _Latest[CallRecord]()  # fusions by the stamp of their cloud
        self.begin_run()

    def begin_run(self) -> None:
        """Forget which pairs maps must contain. Clouds and truth are kept, because a map may be in progress."""
        self.pair_stamps_ns = set[int]()  # stamps of received mapping pairs, which the maps of the run must contain
        self._mapped_until_ns = -1  # stamp of the last pair of the last map

    @property
    def unmapped_pairs(self) -> int:
        """Number of mapping pairs after the last map."""
        return sum(stamp_ns > self._mapped_until_ns for stamp_ns in self.pair_stamps_ns)

    def set_rig(self, rig: StereoRig) -> None:
        """Set the rig of the following pairs."""
        self.rig = rig

    def add_true_points(self, stamp_ns: int, points: PointImage) -> None:
        """Add the true points `(H, W, 3)` of a mapping pair, metres in LM."""
        self._true_points[stamp_ns] = points

    def add_cloud(self, stamp_ns: int, cloud: PointCloud) -> None:
        """Add a published cloud; its stamp is that of its last pair."""
        self._clouds[stamp_ns] = cloud

    def add_pose(self, stamp_ns: int, T_lm_navsb: Transform) -> None:
        """Add the pose of a mapping pair."""
        self._poses[stamp_ns] = T_lm_navsb
        self.pair_stamps_ns.add(stamp_ns)

    def add_call(self, record: CallRecord) -> None:
        """Add a call. The call of a fusion names the pairs of its cloud."""
        if record.state == MappingState.FUSED and record.pair_stamps_ns:
            self._fusions[record.stamp_ns] = record

    def take_complete(self) -> Iterator[tuple[PointCloud, list[PairTruth], int]]:
        """Yield and remove the clouds whose pairs and truth are known, with the truth of each pair.

        The third value is the number of pairs since the last map, which the map must contain.
        """
        for stamp_ns in list(self._clouds):
            fusion = self._fusions.get(stamp_ns)
            if fusion is None or self.rig is None:
                continue
            wanted = fusion.pair_stamps_ns
            if not all(stamp in self._true_points and stamp in self._poses for stamp in wanted):
                continue
            truths = [PairTruth(self._true_points[s], self._poses[s] @ self.rig.T_sb_left, self.rig) for s in wanted]
            last_ns, begin_ns = max(wanted), self._mapped_until_ns
            expected = sum(begin_ns < stamp <= last_ns for stamp in self.pair_stamps_ns)
            self._mapped_until_ns = max(begin_ns, last_ns)
            yield replace(self._clouds.pop(stamp_ns), fused=fusion.is_fused), truths, max(expected, len(wanted))


class MonitorScore:
    """Collects poses, truth, clouds and calls, and scores them; `maps` judges each complete map and keeps the worst."""

    def __init__(self, config: ScoreConfig, limits: Limits | None, body: TrackedBodyConfig = RB_ITSELF) -> None:
        """Start a run, judged by limits if there are any. `body` is the tracked body of the true poses."""
        self.map_inputs = MapInputs()
        self._config, self._limits, self._body = config, limits, body
        self.restart()

    def restart(self) -> None:
        """Discard all data except the clouds and the truth of maps in progress."""
        self.map_inputs.begin_run()
        self._estimates = _Rows(ESTIMATE)
        self._truth = _Rows(TRUE_POSE)
        self._calls = _CallRows()
        self._covariance_ns = -1  # stamp of the last estimate with a published covariance
        self._convention_finding: ConventionFinding | None = None  # result of the last diagnosis
        self._diagnosed_poses = 0  # number of poses at the last diagnosis
        self.maps = LiveMaps(self._limits, partial=self._config.trajectory.partial)

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
        """Add a call, before or after its pose. The call of a fusion names the pairs of its cloud."""
        # The covariance of the pose message is used, so that of the call record is dropped
        if record.stamp_ns == self._covariance_ns:
            record = replace(record, covariance=None)
        self._calls.add_call(record)
        self.map_inputs.add_call(record)

    def score_maps(self) -> bool:
        """Score the clouds whose inputs are complete. Return whether there was a cloud."""
        scored = False
        for cloud, truths, expected in self.map_inputs.take_complete():
            self.maps.add(score_map(cloud, truths, self._config.map, expected_pairs=expected))
            scored = True
        return scored

    def result(self, live: LiveRun = ENDED) -> Score:
        """Return the current score with the errors of its sub-trajectories; by default, also the data of all plots.

        During a run, results of the last seconds (`LiveRun.in_flight_s`) do not count as missing, and the first pose
        and the next map are awaited. After the run, images without poses and the pairs after the last map are missing.
        """
        is_under_way = live.in_flight_s > 0.0
        stats = self._calls.stats()
        truth = self._given_truth()
        estimates = self._given_estimates(stats, is_under_way=is_under_way)
        drive = None
        if truth is not None and estimates is not None:
            drive = DriveToScore(estimates, truth, image_stamps_ns=live.image_stamps_ns)
        unmapped = 0 if is_under_way else self.map_inputs.unmapped_pairs
        surface = self.maps.result
        if surface is not None and unmapped:
            surface = replace(surface, figures=with_unmapped_pairs(surface.figures, unmapped))
        pairs = np.array(sorted(self.map_inputs.pair_stamps_ns), np.int64)
        images_ns = () if live.image_stamps_ns is None else live.image_stamps_ns
        run = Run(
            ScoreInputs(),
            [] if stats is None else [stats],
            drive=drive,
            unposed_images=len(images_ns) if estimates is None and not is_under_way else 0,
            nav_stamps_ns=pairs,
            unmapped_pairs=unmapped if surface is None else 0,
        )
        received = Received(
            run=run, messages=self._poses + len(self._calls), map=surface, convention_finding=self._convention_finding
        )
        return score_so_far(received, live, self._config, self._limits)

    def diagnose(self) -> None:
        """Search for a convention mismatch of estimate and truth, which takes 0.1 s or more.

        The last result is kept until the number of poses has grown by the factor `DIAGNOSED_GROWTH`.
        """
        if self._diagnosed_poses <= self._poses < DIAGNOSED_GROWTH * self._diagnosed_poses:
            return
        self._diagnosed_poses = self._poses
        self._convention_finding = None
        truth, estimates = self._given_truth(), self._given_estimates(None)
        if truth is not None and estimates is not None:
            self._convention_finding = convention_mismatch(DriveToScore(estimates, truth), self._config)

    @property
    def _poses(self) -> int:
        """Number of received estimates and true poses."""
        return len(self._estimates) + len(self._truth)

    def _given_truth(self) -> Truth | None:
        if not len(self._truth):
            return None
        rows = self._truth.all()
        poses = Trajectory(rows["stamp_ns"], rows["position"], rows["quat"])
        return truth_of_rb(RecordedTruth(poses, "", rows["variances"]), self._body)

    def _given_estimates(self, stats: CallStats | None, *, is_under_way: bool = False) -> Estimates | None:
        """Return the estimates with the states and covariances of their calls.

        During a run, the calls of poses after the last call may still arrive. These poses count as reported.
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
