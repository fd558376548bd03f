"""Our localiser beside reference localisers on the same drive."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from sfr_loc_map.bench.competitors import Competitors
from sfr_loc_map.bench.figures import CallCosts, JsonObject
from sfr_loc_map.bench.passes import LIMITS, PassInput, Progress, Run, findings_of, run_passes
from sfr_loc_map.bench.results import Entry, MethodComparison, Provenance, SizeResult
from sfr_loc_map.bench.scaling import half_pair, half_rig
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.calls import CallUsage
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.offline import start_pose

LeftPose = Transform | None
"""Pose of the left camera in its first one; None where it is not known."""


@dataclass(frozen=True, slots=True)
class BenchmarkSettings:
    """What is measured.

    Attributes:
        score: Sub-trajectories.
        repeat: Passes; medians are shown.
        sizes: Number of image sizes, each half of the one before.
        rate_hz: Pairs per second for methods that work in the background; None: as recorded.
    """

    score: TrajectoryScoreConfig
    repeat: int = 3
    sizes: int = 1
    rate_hz: float | None = None


@dataclass(frozen=True, slots=True)
class ConditionErrors:
    """Mean + 3 sigma of the errors over the sub-trajectories of one condition.

    Attributes:
        count: Number of sub-trajectories.
        position_m: Position error, metres.
        attitude_deg: Attitude error, degrees.
        heading_deg: Heading error, degrees.
    """

    count: float
    position_m: float | None
    attitude_deg: float | None
    heading_deg: float | None


@dataclass(frozen=True, slots=True)
class LocalisationFigures:
    """Figures of one pass of a localiser.

    Attributes:
        lost: Number of pairs without a pose.
        accuracy: Errors by condition; None without ground truth.
        costs: Time and memory of the calls.
    """

    lost: float
    accuracy: Mapping[str, ConditionErrors] | None
    costs: CallCosts

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        head: JsonObject = {"lost": self.lost}
        if self.accuracy is not None:
            head["accuracy"] = {name: asdict(errors) for name, errors in self.accuracy.items()}
        return head | self.costs.to_json()


def benchmark_localisation(
    sequence: LocSequence,
    config: LocalisationConfig,
    methods: Competitors,
    settings: BenchmarkSettings,
    progress: Progress = lambda name: None,
) -> MethodComparison[LocalisationFigures]:
    """Return the figures of all localisers on one drive.

    Args:
        sequence: The drive, with ground truth if accuracy is wanted.
        config: Parameters of ours.
        methods: Localisers to compare.
        settings: What is measured.
        progress: Called with the name of a method after each of its calls.

    Raises:
        BenchError: If ours does not run.
    """
    provenance = Provenance.now()
    sizes = [_one_size(sequence, halvings, config, methods, settings, progress) for halvings in range(settings.sizes)]
    conditions = tuple(settings.score.conditions)
    return MethodComparison("localise", len(sequence), conditions, settings.repeat, sizes, methods.missing, provenance)


def _one_size(
    sequence: LocSequence,
    halvings: int,
    config: LocalisationConfig,
    methods: Competitors,
    settings: BenchmarkSettings,
    progress: Progress,
) -> SizeResult[LocalisationFigures]:
    rig = sequence.rig
    for _ in range(halvings):
        rig = half_rig(rig)
    stamps_ns = [pair.stamp_ns for pair in sequence.pairs()]
    recorded_hz = _rate_hz(stamps_ns)
    rate_hz = settings.rate_hz or recorded_hz
    # the rover frame in the left camera: all methods estimate the same pose
    rig = replace(rig, T_rb_sb=rig.T_sb_left.inverse())
    given = PassInput(
        lambda: _pairs(sequence, halvings),
        lambda method: IsolatedMethod(method, rig, Transform.identity(), LIMITS, {"rate_hz": rate_hz}),
        _call,
        rate_hz / recorded_hz,
    )
    runs, failed = run_passes(methods.configured(asdict(config)), given, settings.repeat, progress)
    entries = {
        name: Entry(mine[0].version, [_figures(run, stamps_ns, sequence, settings.score) for run in mine])
        for name, mine in runs.items()
    }
    return SizeResult(rig.width, rig.height, None, entries, failed, findings_of(runs))


def _call(localiser: IsolatedMethod, pair: StereoPair, since_start_s: float) -> tuple[LeftPose, CallUsage, str]:
    estimate, call = localiser.localise(pair, {"since_start_s": since_start_s})
    lost = estimate.state is TrackingState.LOST
    return None if lost else estimate.T_ds_rb, call.usage, call.finding


def _pairs(sequence: LocSequence, halvings: int) -> Iterator[StereoPair]:
    for pair in sequence.pairs():
        for _ in range(halvings):
            pair = half_pair(pair)
        yield pair


def _rate_hz(stamps_ns: Sequence[int]) -> float:
    steps = np.diff(stamps_ns)
    return NS_PER_S / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 10.0


def _figures(
    run: Run[LeftPose], stamps_ns: Sequence[int], sequence: LocSequence, config: TrajectoryScoreConfig
) -> LocalisationFigures:
    lost = sum(pose is None for pose in run.results)
    errors = None if sequence.ground_truth is None else accuracy(run.results, stamps_ns, sequence, config)
    return LocalisationFigures(lost, errors, CallCosts.of(run.seconds, run.peaks, run.idle_bytes))


def accuracy(
    poses: Sequence[LeftPose], stamps_ns: Sequence[int], sequence: LocSequence, config: TrajectoryScoreConfig
) -> dict[str, ConditionErrors]:
    """Return mean + 3 sigma of each kind of error by condition.

    A pair without a pose has the last known one, as the suite's own localiser reports it.

    Args:
        poses: Pose of each pair.
        stamps_ns: Stamps of the pairs.
        sequence: The drive with its ground truth.
        config: Sub-trajectories.
    """
    truth = sequence.ground_truth
    assert truth is not None
    T_rb_left = _rig_on_rover(sequence.rig).T_rb_left
    T_ds_first, T_left_rb = start_pose(sequence, "truth").T_ds_rb @ T_rb_left, T_rb_left.inverse()
    last = T_ds_first @ T_left_rb
    stamped = []
    for stamp_ns, pose in zip(stamps_ns, poses, strict=True):
        if pose is not None:
            last = T_ds_first @ pose @ T_left_rb
        stamped.append((stamp_ns, last))
    lost = np.array([pose is None for pose in poses], np.bool_)
    score = score_trajectory(Estimates.of(Trajectory.from_poses(stamped), lost), truth, config).score
    return {
        text: ConditionErrors(
            part.count,
            part.position_m.mean_plus_3sigma,
            part.attitude_deg.mean_plus_3sigma,
            part.heading_deg.mean_plus_3sigma,
        )
        for text, part in zip(config.conditions, score.conditions, strict=True)
    }


def _rig_on_rover(rig: StereoRig) -> StereoRig:
    """Return the rig; without extrinsics on the rover, the stereo rig's own frame stands for the rover's."""
    return rig if rig.T_rb_sb is not None else replace(rig, T_rb_sb=Transform.identity())
