"""Benchmark of our localiser with single injected faults: errors of the poses relative to their stated sigmas."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from itertools import groupby
from typing import Any

import numpy as np

from sfr_loc_map.bench.provenance import SCHEMA, provenance
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.faults.source import FaultyLoc
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.runs.drive_start import start_pose
from sfr_loc_map.runs.localiser_run import localise, trajectory_of
from sfr_loc_map.signals import hold

FAULTS = (
    "dropped:share=0.2", "repeated:share=0.2", "swapped", "black", "black:burst=5", "black:camera=left",
    "black:camera=right,burst=5", "blinded:share=0.2", "blinded:share=0.2,camera=left", "blurred:share=0.3",
    "blurred:share=0.3,camera=right", "noisy:share=1", "exposure:share=0.3",
    "exposure:share=0.3,camera=right,amount=0.7", "roll:amount=0.1", "pitch:amount=0.06", "yaw:amount=0.03",
    "drift", "start", "fade", "frozen", "frozen:camera=right", "torn", "identical", "saturation:share=0.3", "body",
    "object:share=0.2", "dirt", "shadow", "body:amount=0.6", "texture", "arm:share=0.2", "reflection",
    "reflection:start=20", "scratch", "ghost:share=0.3", "interlaced:share=0.3", "shear:share=0.3",
    "yaw:amount=0.3", "shift",
)  # fmt: skip
"""Faults of real rovers; a row for each kind that a localiser should detect or tolerate (`faults/kinds.py`).

A rotation of 0.06 deg is about half a pixel at an image width of 512 px and a field of view of 60 deg.
"""
NO_FAULT = "none"  #: Name of the drive without a fault.
SILENT_RATIO = 5.0
"""Multiple of the stated 3 sigma above which an error is silent. Chosen because an error of 15 sigma is not random."""
TRACKING = (TrackingState.INITIALISING, TrackingState.TRACKING)
"""States of the pairs that are called tracking here: pose and covariance are valid."""


class ErrorReport(StrEnum):
    """How the localiser reported its errors."""

    SILENT = "silent"  #: Errors beyond the limit in tracking pairs.
    REPORTED = "reported"  #: No silent errors; a problem was reported by degraded or lost pairs.
    NOT_SILENT = "not silent"  #: No silent errors and no degraded or lost pairs. Errors may exceed the stated 3 sigma.
    NOT_COMPARED = "not compared"  #: No true pose has the stamp of a tracking pair.


@dataclass(frozen=True, slots=True)
class StatedErrors:
    """Ratios of error to stated 3 sigma on one drive, over the tracking pairs (`TRACKING`)."""

    tracking: int  #: Number of tracking pairs.
    degraded: int  #: Number of degraded pairs.
    lost: int  #: Number of lost pairs.
    compared: int = 0  #: Number of tracking pairs that have a true pose at their stamp.
    position_ratio: float | None = None
    """Largest ratio of a position error to its 3 sigma, with sigma^2 the trace of the covariance."""
    attitude_ratio: float | None = None  #: Largest ratio of an attitude error to its 3 sigma.
    step_ratio: float | None = None  #: Largest ratio of the translation or rotation error of a step to its 3 sigma.
    beyond_share: float | None = None
    """Fraction of the compared pairs whose largest ratio (position, attitude or step) exceeds `SILENT_RATIO`."""
    largest_error_m: float | None = None  #: Largest position error of compared pairs, metres.

    @property
    def error_report(self) -> ErrorReport:
        """How the localiser reported its errors."""
        if self.beyond_share:
            return ErrorReport.SILENT
        if self.tracking and not self.compared:
            return ErrorReport.NOT_COMPARED
        return ErrorReport.REPORTED if self.degraded + self.lost else ErrorReport.NOT_SILENT


@dataclass(frozen=True, slots=True)
class FaultEntry:
    """Figures of the drive with one fault; position and heading errors are mean + 3 sigma, without lost pairs."""

    pairs: int
    position_m: float | None
    heading_deg: float | None
    longest_lost: int  #: Largest number of consecutive lost pairs.
    vertical_offset_px: float | None  #: Vertical offset at the last pair, as estimated by the localiser.
    disparity_offset_px: float | None  #: Disparity offset at the last pair, as estimated by the localiser.
    stated: StatedErrors

    def content(self) -> dict[str, Any]:
        """Return the entry for the JSON file."""
        figures = asdict(self)
        stated = figures.pop("stated")
        return {**figures, **stated, "error_report": self.stated.error_report.value}


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultBenchmark:
    """Figures of our localiser on a drive with each fault."""

    condition: str  #: Condition of the sub-trajectories.
    seed: int  #: Seed that selects the affected pairs.
    faults: Sequence[str]  #: All requested faults, after `NO_FAULT`.
    entries: Mapping[str, FaultEntry]  #: By fault.
    missing: Mapping[str, str]  #: Why faults have no figures, by fault.
    provenance: Mapping[str, Any]

    @property
    def silent(self) -> list[str]:
        """The faults with silent errors."""
        return self._faults_with(ErrorReport.SILENT)

    @property
    def not_compared(self) -> list[str]:
        """The faults with which no pair was compared with the ground truth."""
        return self._faults_with(ErrorReport.NOT_COMPARED)

    @property
    def interrupted(self) -> str:
        """Number of finished drives if the user interrupted the benchmark; otherwise empty."""
        done = len(self.entries) + len(self.missing)
        return f"{done} of {len(self.faults)} drives" if done < len(self.faults) else ""

    def _faults_with(self, error_report: ErrorReport) -> list[str]:
        return [fault for fault, entry in self.entries.items() if entry.stated.error_report is error_report]

    def content(self) -> dict[str, Any]:
        """Return the content of the JSON file."""
        content: dict[str, Any] = {
            "schema": SCHEMA,
            "kind": "faults",
            "condition": self.condition,
            "seed": self.seed,
            "limit": SILENT_RATIO,
            "provenance": dict(self.provenance),
            "entries": {fault: entry.content() for fault, entry in self.entries.items()},
            "missing": dict(self.missing),
        }
        return content | ({"interrupted": self.interrupted} if self.interrupted else {})


def stated_errors(estimates: Sequence[PoseEstimate], truth: Trajectory) -> StatedErrors:
    """Compare the errors of a drive with the stated sigmas; pairs without a true pose at their stamp are omitted."""
    states = [estimate.state for estimate in estimates]
    tracking = [estimate for estimate in estimates if estimate.state in TRACKING]
    counted = StatedErrors(len(tracking), states.count(TrackingState.DEGRADED), states.count(TrackingState.LOST))
    true_poses = TruePoses(truth)
    compared = [estimate for estimate in tracking if true_poses.at(estimate.stamp_ns) is not None]
    if not compared:
        return counted
    poses = np.array([pose_error(estimate, true_poses) for estimate in compared])
    steps = np.array([step_error(estimate, true_poses) for estimate in compared])
    position_ratios, attitude_ratios = _ratios(poses).T
    step_ratios = _ratios(steps).max(axis=1)
    largest_ratios = np.maximum(np.maximum(position_ratios, attitude_ratios), step_ratios)
    return replace(
        counted,
        compared=len(compared),
        position_ratio=float(position_ratios.max()),
        attitude_ratio=float(attitude_ratios.max()),
        step_ratio=float(step_ratios.max()),
        beyond_share=float((largest_ratios > SILENT_RATIO).mean()),
        largest_error_m=float(poses[:, 0, 0].max()),
    )


class TruePoses:
    """The true poses of a drive by their stamps, and their noise."""

    def __init__(self, truth: Trajectory) -> None:
        self._truth = truth
        self._rows = {int(stamp): row for row, stamp in enumerate(truth.stamps_ns)}
        #: Sigma of one axis of the true position, m, and of the true attitude, rad.
        self.sigma = (truth.sigma_m, np.radians(truth.sigma_deg)) if isinstance(truth, Truth) else (0.0, 0.0)

    def at(self, stamp_ns: int) -> Transform | None:
        """Return the true pose of RB in DS at a stamp; None if no true pose has this stamp."""
        row = self._rows.get(stamp_ns)
        return None if row is None else self._truth.pose(row)


def _ratios(errors_and_sigmas: FloatArray) -> FloatArray:
    """Return errors divided by 3 sigma, `(N, 2)`; 0 for an error of 0, even if its sigma is 0."""
    errors, sigmas = errors_and_sigmas[:, 0], errors_and_sigmas[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(errors > 0.0, errors / (3.0 * sigmas), 0.0)


def pose_error(estimate: PoseEstimate, true_poses: TruePoses) -> FloatArray:
    """Return error and sigma `(2, 2)` of an estimate with a true pose: position, m, and attitude, rad, in each row.

    The sigma combines the stated covariance and the noise of the true pose.
    """
    true = true_poses.at(estimate.stamp_ns)
    assert true is not None
    return _error_and_sigma(estimate.T_ds_rb, true, estimate.covariance, true_poses.sigma, noisy_poses=1)


def step_error(estimate: PoseEstimate, true_poses: TruePoses) -> FloatArray:
    """Return error and sigma `(2, 2)` of the step to an estimate, as `pose_error`; 0 without a true pose at an end."""
    step, true = estimate.step, true_poses.at(estimate.stamp_ns)
    before = None if step is None else true_poses.at(estimate.stamp_ns - round(step.seconds * NS_PER_S))
    if step is None or before is None or true is None:
        return np.zeros((2, 2))
    motion = Transform(matrix_from_rotvec(step.motion[3:]), step.motion[:3])
    return _error_and_sigma(motion, before.inverse() @ true, step.motion_covariance, true_poses.sigma, noisy_poses=2)


def _error_and_sigma(
    pose: Transform, true: Transform, covariance: FloatArray, noise: tuple[float, float], noisy_poses: int
) -> FloatArray:
    """Return error and sigma `(2, 2)` of a transform that was compared with one or two noisy true poses.

    The squared errors sum three axes, each of which contains the noise of each true pose.
    """
    turn = rotvec_from_matrix(pose.rotation @ true.rotation.T)
    errors = np.linalg.norm(pose.translation - true.translation), np.linalg.norm(turn)
    variances = np.array([np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])])
    return np.array([errors, np.sqrt(variances + 3.0 * noisy_poses * np.square(noise))])


def benchmark_faults(
    sequence: LocSequence,
    faults: Sequence[str],
    config: LocalisationConfig,
    scoring: TrajectoryScoreConfig,
    seed: int = 0,
    progress: Callable[[], None] = lambda: None,
) -> FaultBenchmark:
    """Localise a drive with ground truth without a fault and with each fault, and return the figures.

    An item of `faults` may join several faults by `+`. After an interrupt, the finished faults are reported.
    """
    truth = sequence.ground_truth
    assert truth is not None
    begun = provenance()
    injected = {NO_FAULT: [], **{text: [parse_fault(part) for part in text.split("+")] for text in faults}}
    entries: dict[str, FaultEntry] = {}
    missing: dict[str, str] = {}
    try:
        for name, parsed in injected.items():
            try:
                drive = FaultyLoc(sequence, parsed, seed)
                made = [estimate for estimate, _ in localise(drive, config, start_pose(sequence, "truth"))]
                entries[name] = fault_figures(made, truth, scoring)
            except SfrError as error:
                if name == NO_FAULT:
                    raise
                missing[name] = str(error)
            progress()
    except KeyboardInterrupt:
        if not entries:
            raise
    finally:
        hold()
    return FaultBenchmark(
        condition=scoring.conditions[0],
        seed=seed,
        faults=list(injected),
        entries=entries,
        missing=missing,
        provenance=begun,
    )


def fault_figures(estimates: Sequence[PoseEstimate], truth: Trajectory, scoring: TrajectoryScoreConfig) -> FaultEntry:
    """Return the figures of the drive with one fault; raise InputError if the fault has left no pair."""
    if not estimates:
        raise InputError("the fault has left no pair of images")
    lost = [estimate.state is TrackingState.LOST for estimate in estimates]
    known = [estimate for estimate, gone in zip(estimates, lost, strict=True) if not gone]
    figures = score_trajectory(Estimates.of(trajectory_of(known)), truth, scoring).figures if known else ()
    score = Score(figures=figures)
    last = estimates[-1].statistics
    return FaultEntry(
        pairs=len(estimates),
        position_m=score.number("position", "mean_plus_3sigma", part=scoring.rebase),
        heading_deg=score.number("heading", "mean_plus_3sigma", part=scoring.rebase),
        longest_lost=max((len(list(run)) for gone, run in groupby(lost) if gone), default=0),
        vertical_offset_px=last.vertical_offset_px,
        disparity_offset_px=last.disparity_offset_px,
        stated=stated_errors(estimates, truth),
    )
