"""Benchmark of our localiser with single injected faults: errors of the poses relative to their stated sigmas."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from itertools import groupby
from typing import Any

import numpy as np

from sfr_loc_map.bench.method_benchmark import SCHEMA, provenance
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.faults.source import FaultyLoc
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.runs.offline import localise, start_pose, trajectory_of
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

A rotation of 0.06 deg is about half a pixel at 512 px and 60 deg field of view.
"""
LIMIT = 5.0  #: An error above this many stated 3 sigma is silent, because 15 sigma cannot be random (chosen).
VALID = (TrackingState.INITIALISING, TrackingState.TRACKING)  #: States in which pose and covariance are valid.


class Honesty(StrEnum):
    """How the localiser reported its errors."""

    SILENT = "silent"  #: Errors beyond the limit in pairs with a valid state.
    SAID = "said"  #: No silent errors; a problem was reported by degraded or lost pairs.
    STATED = "stated"  #: No silent errors and no degraded or lost pairs; the errors are within the stated sigmas.


@dataclass(frozen=True, slots=True)
class StatedErrors:
    """Ratios of error to stated 3 sigma on one drive, over the pairs with a valid state."""

    valid: int  #: Number of pairs with a valid state; the key `tracking` of the JSON.
    degraded: int  #: Number of degraded pairs.
    lost: int  #: Number of lost pairs.
    position_ratio: float | None = None  #: Largest position error over its 3 sigma (root of the covariance's trace).
    attitude_ratio: float | None = None  #: Largest attitude error over its 3 sigma.
    step_ratio: float | None = None  #: Largest error of a step, translation or rotation, over its 3 sigma.
    beyond_share: float | None = None  #: Fraction of valid pairs with a ratio above `LIMIT`.
    largest_error_m: float | None = None  #: Largest position error of valid pairs, metres.

    @property
    def honesty(self) -> Honesty:
        """How the localiser reported its errors."""
        if self.beyond_share:
            return Honesty.SILENT
        return Honesty.SAID if self.degraded + self.lost else Honesty.STATED


@dataclass(frozen=True, slots=True)
class FaultEntry:
    """Figures of one drive; position and heading errors are mean + 3 sigma over the pairs that are not lost."""

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
        return {**figures, "tracking": stated.pop("valid"), **stated, "honesty": self.stated.honesty.value}


def stated_errors(estimates: Sequence[PoseEstimate], truth: Trajectory) -> StatedErrors:
    """Compare the errors of a drive with the stated sigmas; pairs without a true pose at their stamp are omitted."""
    states = [estimate.state for estimate in estimates]
    valid = [estimate for estimate in estimates if estimate.state in VALID]
    counted = StatedErrors(len(valid), states.count(TrackingState.DEGRADED), states.count(TrackingState.LOST))
    errors, sigmas = error_and_sigma(valid, truth)
    if not len(errors):
        return counted
    position_ratios, attitude_ratios = _ratios(errors, sigmas).T
    step_ratios = _ratios(*error_and_sigma(valid, truth, steps=True)).max(axis=1)
    largest_ratios = np.maximum(np.maximum(position_ratios, attitude_ratios), step_ratios)
    return replace(
        counted,
        position_ratio=float(position_ratios.max()),
        attitude_ratio=float(attitude_ratios.max()),
        step_ratio=float(step_ratios.max()),
        beyond_share=float((largest_ratios > LIMIT).mean()),
        largest_error_m=float(errors[:, 0].max()),
    )


def _ratios(errors: FloatArray, sigmas: FloatArray) -> FloatArray:
    """Return errors divided by 3 sigma; 0 for an error of 0, also if its sigma is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(errors > 0.0, errors / (3.0 * sigmas), 0.0)


def error_and_sigma(
    estimates: Sequence[PoseEstimate], truth: Trajectory, *, steps: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return errors and sigmas `(N, 2)` of position, m, and attitude, rad, at stamps with a true pose.

    The sigmas combine the stated covariance and the noise of the ground truth. With `steps`, the values are those of
    the steps to these poses; errors are 0 if a step has no true pose at both ends.
    """
    noise = (truth.sigma_m, np.radians(truth.sigma_deg)) if isinstance(truth, Truth) else (0.0, 0.0)
    at = {int(stamp): index for index, stamp in enumerate(truth.stamps_ns)}
    known = [estimate for estimate in estimates if estimate.stamp_ns in at]
    errors, variances = np.zeros((len(known), 2)), np.zeros((len(known), 2))
    for row, estimate in enumerate(known):
        pose, true, covariance = estimate.T_ds_rb, truth.pose(at[estimate.stamp_ns]), estimate.covariance
        if steps:
            step = estimate.step
            before = None if step is None else at.get(estimate.stamp_ns - round(step.seconds * NS_PER_S))
            if step is None or before is None:
                continue
            pose, covariance = Transform(matrix_from_rotvec(step.motion[3:]), step.motion[:3]), step.motion_covariance
            true = truth.pose(before).inverse() @ true
        turn = rotvec_from_matrix(pose.rotation @ true.rotation.T)
        errors[row] = np.linalg.norm(pose.translation - true.translation), np.linalg.norm(turn)
        variances[row] = np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])
    # the norm has three axes, each with the noise of one true pose, or of the two true poses of a step
    noisy_values = 6.0 if steps else 3.0
    return errors, np.sqrt(variances + noisy_values * np.square(noise))


def benchmark_faults(
    sequence: LocSequence,
    faults: Sequence[str],
    config: LocalisationConfig,
    scoring: TrajectoryScoreConfig,
    seed: int = 0,
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Return the JSON content of the localiser's figures on a drive with ground truth, for `none` and each fault.

    Several faults may be joined by `+`. After an interrupt, the content has the finished faults.
    """
    truth = sequence.ground_truth
    assert truth is not None
    head = {"schema": SCHEMA, "kind": "faults", "condition": scoring.conditions[0], "seed": seed, "limit": LIMIT}
    head["provenance"] = provenance()
    parsed = {"none": [], **{text: [parse_fault(part) for part in text.split("+")] for text in faults}}
    entries: dict[str, FaultEntry] = {}
    missing: dict[str, str] = {}  # reasons of faults without figures
    try:
        for name, injected in parsed.items():
            drive = FaultyLoc(sequence, injected, seed)
            made = [estimate for estimate, _ in localise(drive, config, start_pose(sequence, "truth"))]
            try:
                if not made:
                    raise InputError("no pair is left")
                entries[name] = fault_figures(made, truth, scoring)
            except SfrError as error:
                if not injected:
                    raise
                missing[name] = str(error)
            progress()
    except KeyboardInterrupt:
        if not entries:
            raise
    finally:
        hold()
    done = len(entries) + len(missing)
    interrupted = {"interrupted": f"{done} of {len(parsed)} runs"} if done < len(parsed) else {}
    content = {name: entry.content() for name, entry in entries.items()}
    return head | {"entries": content, "missing": missing, **interrupted}


def fault_figures(estimates: Sequence[PoseEstimate], truth: Trajectory, scoring: TrajectoryScoreConfig) -> FaultEntry:
    """Return the figures of one drive."""
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
