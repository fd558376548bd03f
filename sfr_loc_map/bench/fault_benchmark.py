"""Our localiser on data with one fault at a time: the error of each pose beside the standard deviation stated of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from itertools import groupby
from typing import Any

import numpy as np

from sfr_loc_map.bench.method_benchmark import SCHEMA
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
"""Faults of real rovers; 0.06 deg of rotation of the right camera is about half a pixel at 512 px and 60 deg."""
LIMIT = 5.0  #: Largest error over the stated 3 sigma that still counts as stated: 15 sigma is no chance (chosen).
VALID = ("initialising", "tracking")  #: States whose pose and covariance are to be used.


class Honesty(StrEnum):
    """How errors were reported."""

    SILENT = "silent"  #: Beyond the limit, and called tracking.
    SAID = "said"  #: Degraded or lost pairs, and none beyond the limit that was called tracking.
    STATED = "stated"  #: All errors within the limit, and no pair degraded or lost.


@dataclass(frozen=True, slots=True)
class StatedErrors:
    """Errors over the stated 3 sigma on one drive, over pairs that are called tracking (or initialising)."""

    tracking: int  #: Number of such pairs.
    degraded: int  #: Number of pairs whose state is degraded.
    lost: int  #: Number of pairs whose state is lost.
    position_ratio: float | None  #: Largest position error over its stated 3 sigma (root of the covariance's trace).
    attitude_ratio: float | None  #: The same of the attitude.
    step_ratio: float | None  #: Largest error, of translation or rotation, of the step to such a pair, likewise.
    beyond_share: float | None  #: Share of such pairs with any of them beyond `LIMIT`.
    largest_error_m: float | None  #: Largest position error of such pairs, metres.

    @property
    def honesty(self) -> Honesty:
        """How the localiser reported its errors."""
        if self.beyond_share:
            return Honesty.SILENT
        return Honesty.SAID if self.degraded + self.lost else Honesty.STATED


@dataclass(frozen=True, slots=True)
class FaultEntry:
    """Figures of one drive; position and heading are mean + 3 sigma of the pairs that are not lost."""

    pairs: int
    position_m: float | None
    heading_deg: float | None
    longest_lost: int  #: Number of pairs of the longest run of lost pairs.
    vertical_offset_px: float | None  #: At the last pair, as estimated by the localiser.
    disparity_offset_px: float | None  #: At the last pair, as estimated by the localiser.
    stated: StatedErrors

    def content(self) -> dict[str, Any]:
        """Return the entry of the JSON."""
        figures = asdict(self)
        stated = figures.pop("stated")
        return {**figures, **stated, "honesty": self.stated.honesty.value}


def stated_errors(estimates: Sequence[PoseEstimate], truth: Trajectory) -> StatedErrors:
    """Return how the errors of a drive compare with what is stated; pairs without truth of their stamp are omitted."""
    states = [str(estimate.state.value) for estimate in estimates]
    valid = [estimate for estimate, state in zip(estimates, states, strict=True) if state in VALID]
    errors, sigmas = error_and_sigma(valid, truth)
    step_errors, step_sigmas = error_and_sigma(valid, truth, steps=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios, steps = (
            np.where(found > 0.0, found / (3.0 * sigma), 0.0)
            for found, sigma in ((errors, sigmas), (step_errors, step_sigmas))
        )
        ratios = np.column_stack((ratios, steps.max(axis=1)))
    figures: list[float | None] = [None] * 5
    if len(ratios):
        beyond = (ratios > LIMIT).any(axis=1).mean()
        figures = [float(value) for value in (*ratios.max(axis=0), beyond, errors[:, 0].max())]
    return StatedErrors(len(valid), states.count("degraded"), states.count("lost"), *figures)


def error_and_sigma(
    estimates: Sequence[PoseEstimate], truth: Trajectory, *, steps: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return errors and standard deviations `(N, 2)` of position (m) and attitude (rad) where there is truth.

    The standard deviations are those stated, with the noise of the truth. Of `steps`: the same of the steps to these
    poses, 0 where there is no step between stamps with truth.
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
    return errors, np.sqrt(variances + (6.0 if steps else 3.0) * np.square(noise))


def benchmark_faults(
    sequence: LocSequence,
    faults: Sequence[str],
    config: LocalisationConfig,
    scoring: TrajectoryScoreConfig,
    seed: int = 0,
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Return the JSON of the localiser's figures on a drive with truth, for `none` and each fault (joined by `+`).

    Interrupted, those of the faults that are done.
    """
    truth = sequence.ground_truth
    assert truth is not None
    parsed = {"none": [], **{text: [parse_fault(part) for part in text.split("+")] for text in faults}}
    entries: dict[str, FaultEntry] = {}
    missing: dict[str, str] = {}  # why a fault has no figures
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
    head = {"schema": SCHEMA, "kind": "faults", "condition": scoring.conditions[0], "seed": seed, "limit": LIMIT}
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
