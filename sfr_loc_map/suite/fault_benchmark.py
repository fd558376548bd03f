"""Our localiser and our mapper on data with one fault at a time: do they know how wrong they are?

The error of each pose, and of each point of a map, stands beside the standard deviation that is stated of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.sequence import LocSequence, NavSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper, PairMap
from sfr_loc_map.methods.comparison import SCHEMA
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.cloud_error import pixel_coverage, point_errors, truths_of
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.convert import FaultyLoc, FaultyNav
from sfr_loc_map.pipeline.offline import localise, start_pose, trajectory_of
from sfr_loc_map.simulation.faults import Fault, parse_fault

FAULTS = (
    "dropped:share=0.2", "repeated:share=0.2", "swapped", "black", "black:burst=5", "black:camera=left",
    "black:camera=right,burst=5", "blinded:share=0.2", "blinded:share=0.2,camera=left", "blurred:share=0.3",
    "blurred:share=0.3,camera=right", "noisy:share=1", "exposure:share=0.3",
    "exposure:share=0.3,camera=right,amount=0.7", "roll:amount=0.1", "pitch:amount=0.06", "yaw:amount=0.03",
    "drift", "start", "fade", "frozen", "frozen:camera=right", "torn", "identical", "saturation:share=0.3", "body",
    "object:share=0.2", "dirt", "shadow",
)  # fmt: skip
"""Faults of real rovers; 0.06 deg of rotation of the right camera is about half a pixel at 512 px and 60 deg."""
MAP_FAULTS = (
    "yaw:amount=0.03", "yaw", "pitch", "roll", "focal", "baseline", "blurred", "blurred:camera=right", "noisy",
    "exposure", "exposure:camera=right,amount=0.7", "saturation", "saturation:camera=right", "blinded",
    "blinded:camera=left", "dirt", "shadow", "body", "torn:share=0.5", "repeated:share=0.5", "swapped", "identical",
    "black:camera=right",
)  # fmt: skip
"""Faults of cameras and calibrations; those of images affect all pairs."""
LIMIT = 5.0  #: Largest error over the stated 3 sigma that still counts as stated.
VALID = ("initialising", "tracking")  #: States whose pose and covariance are to be used.
JUMP_SIGMA = 3.0
SCORED_TO_M = 10.0
LIMIT_SHARE = 0.01
"""Share of points beyond the limit from which on a map counts as wrong: beside edges some always are."""


class Honesty(StrEnum):
    """What was said of errors."""

    SILENT = "silent"
    """Beyond the limit, and called tracking; or a wrong map without a warning."""
    SAID = "said"
    """Degraded or lost pairs, and none beyond the limit that was called tracking; or a warning or a refusal."""
    STATED = "stated"
    """All errors within the limit, and nothing else said."""


@dataclass(frozen=True, slots=True)
class StatedErrors:
    """Errors over the stated 3 sigma on one drive, over pairs that are called tracking (or initialising)."""

    tracking: int  #: Number of such pairs.
    degraded: int  #: Number of pairs whose state is degraded.
    lost: int  #: Number of pairs whose state is lost.
    #: Largest position error over its stated 3 sigma (the root of the trace of the covariance); None without such
    #: pairs.
    position_ratio: float | None
    attitude_ratio: float | None  #: The same of the attitude.
    beyond_share: float | None  #: Share of such pairs with either beyond `LIMIT`; None without such pairs.
    largest_error_m: float | None  #: Largest position error of such pairs, metres.

    @property
    def honesty(self) -> Honesty:
        """What the localiser said of its errors."""
        if self.beyond_share:
            return Honesty.SILENT
        return Honesty.SAID if self.degraded + self.lost else Honesty.STATED


def stated_errors(estimates: Sequence[PoseEstimate], truth: Trajectory) -> StatedErrors:
    """Return how the errors of a drive compare with what is stated; pairs without truth of their stamp are left out."""
    states = [str(estimate.state.value) for estimate in estimates]
    valid = [estimate for estimate, state in zip(estimates, states, strict=True) if state in VALID]
    errors, sigmas = error_and_sigma(valid, truth)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(errors > 0.0, errors / (3.0 * sigmas), 0.0)
    figures: list[float | None] = [None] * 4
    if len(ratios):
        beyond = (ratios > LIMIT).any(axis=1).mean()
        figures = [float(value) for value in (*ratios.max(axis=0), beyond, errors[:, 0].max())]
    return StatedErrors(len(valid), states.count("degraded"), states.count("lost"), *figures)


def error_and_sigma(estimates: Sequence[PoseEstimate], truth: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return errors and stated standard deviations `(N, 2)` of position (m) and attitude (rad) where there is truth."""
    at = {int(stamp): index for index, stamp in enumerate(truth.stamps_ns)}
    errors, sigmas = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for estimate in estimates:
        if estimate.stamp_ns not in at:
            continue
        true, found, covariance = truth.pose(at[estimate.stamp_ns]), estimate.T_ds_rb, estimate.covariance
        rotation = rotvec_from_matrix(found.rotation @ true.rotation.T)
        errors.append(np.array([[np.linalg.norm(found.translation - true.translation), np.linalg.norm(rotation)]]))
        sigmas.append(np.sqrt([[np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])]]))
    return np.concatenate(errors), np.concatenate(sigmas)


def benchmark_faults(
    sequence: LocSequence,
    faults: Sequence[str],
    config: LocalisationConfig,
    scoring: TrajectoryScoreConfig,
    seed: int = 0,
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Return the figures of the localiser on a drive with its truth, without (`none`) and with each fault, as JSON.

    A fault is a text for `parse_fault`, or several joined by `+`; the first condition of the scoring is shown.

    Raises ConfigError if a fault is not known.
    """
    truth = sequence.ground_truth
    assert truth is not None

    def figures(injected: list[Fault]) -> dict[str, Any]:
        drive = FaultyLoc(sequence, injected, seed)
        return fault_figures(
            [made for made, _ in localise(drive, config, start_pose(sequence, "truth"))], truth, scoring
        )

    head = {"schema": SCHEMA, "kind": "faults", "condition": scoring.conditions[0], "seed": seed, "limit": LIMIT}
    return head | _with_each(faults, parse_fault, figures, progress)


def benchmark_map_faults(
    sequence: NavSequence,
    faults: Sequence[str],
    config: MappingConfig,
    seed: int = 0,
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Return the same of the mapper on up to three pairs with their truth.

    Raises:
        ConfigError: If a fault is not known.
        MetricsError: If a pair has no truth.
    """
    truths_of(list(sequence.pairs()), sequence.rig)

    def figures(injected: list[Fault]) -> dict[str, Any]:
        faulty = FaultyNav(sequence, injected, seed)
        return map_fault_figures(list(faulty.pairs()), faulty.rig, sequence.rig, config)

    head = {"schema": SCHEMA, "kind": "map-faults", "seed": seed, "to_m": SCORED_TO_M, "limit": LIMIT}
    return head | {"limit_share": LIMIT_SHARE} | _with_each(faults, _of_all_pairs, figures, progress)


def _with_each(
    faults: Sequence[str],
    parse: Callable[[str], Fault],
    figures: Callable[[list[Fault]], dict[str, Any]],
    progress: Callable[[], None],
) -> dict[str, Any]:
    parsed = {"none": [], **{text: [parse(part) for part in text.split("+")] for text in faults}}
    entries = {}
    for name, injected in parsed.items():
        entries[name] = figures(injected)
        progress()
    return {"entries": entries, "missing": {}}


def silent_faults(result: dict[str, Any]) -> list[str]:
    """Return the faults of a benchmark whose errors were not said."""
    return [name for name, figures in result["entries"].items() if figures["honesty"] == Honesty.SILENT]


def fault_figures(
    estimates: Sequence[PoseEstimate], truth: Trajectory, scoring: TrajectoryScoreConfig
) -> dict[str, Any]:
    """Return the figures of one drive, as JSON values.

    Position (m) and heading (deg): mean + 3 sigma over sub-trajectories of the pairs that are not lost. A silent jump
    is a motion from one such pair to the next that is wrong by more than three times the standard deviation of the
    position that is stated at either end.
    """
    lost = [estimate.state is TrackingState.LOST for estimate in estimates]
    known = [estimate for estimate, gone in zip(estimates, lost, strict=True) if not gone]
    scored = score_trajectory(Estimates.of(trajectory_of(known)), truth, scoring).score.first if known else None
    jumps, last = jump_sigmas(known, truth), estimates[-1].statistics
    stated = stated_errors(estimates, truth)
    return {
        "pairs": len(estimates),
        "position_m": None if scored is None else scored.position_m.mean_plus_3sigma,
        "heading_deg": None if scored is None else scored.heading_deg.mean_plus_3sigma,
        "longest_lost": max((len(list(run)) for gone, run in groupby(lost) if gone), default=0),
        "silent_jumps": int(np.count_nonzero(jumps > JUMP_SIGMA)),
        "largest_jump_sigma": float(jumps.max()) if len(jumps) else None,
        "vertical_offset_px": last.vertical_offset_px,
        "disparity_offset_px": last.disparity_offset_px,
        **asdict(stated),
        "honesty": stated.honesty.value,
    }


def jump_sigmas(estimates: Sequence[PoseEstimate], truth: Trajectory) -> FloatArray:
    """Return the error of each motion `(N - 1,)` over the larger of the standard deviations stated at its ends."""
    at = {int(stamp): index for index, stamp in enumerate(truth.stamps_ns)}
    pairs = [(estimate, truth.pose(at[estimate.stamp_ns])) for estimate in estimates if estimate.stamp_ns in at]
    sigmas = []
    for (before, true_before), (now, true_now) in pairwise(pairs):
        moved = true_before @ before.T_ds_rb.inverse() @ now.T_ds_rb
        error = np.linalg.norm(moved.translation - true_now.translation)
        # the less certain end bounds the certainty of a motion
        variance = max(float(np.trace(end.covariance[:3, :3])) for end in (before, now))
        sigmas.append(error / np.sqrt(variance))
    return np.array(sigmas)


def _of_all_pairs(text: str) -> Fault:
    """Return a fault that begins with the first pair and affects all, unless its text says otherwise."""
    fault = parse_fault(text)
    said = {item.partition("=")[0] for item in text.partition(":")[2].split(",")}
    return replace(
        fault, share=fault.share if "share" in said else 1.0, start=fault.start if said & {"start", "share"} else 0
    )


def map_fault_figures(
    pairs: Sequence[PosedStereoPair], rig: StereoRig, true_rig: StereoRig, config: MappingConfig
) -> dict[str, Any]:
    """Return the figures of the fused map of pairs, as JSON values; ratios are errors over the stated 3 sigma.

    The pairs, as the mapper gets them, have the truth of those without fault; `true_rig` is the rig of that truth.

    Raises:
        ConfigError: If the parameters do not fit the rig.
        MappingError: If there are more pairs than a map may have.
    """
    mapper = Mapper(rig, config)
    maps: list[PairMap] = []
    mapped: list[PosedStereoPair] = []
    for item in pairs:
        try:
            maps.append(mapper.process(item.pair, item.T_lm_navsb, len(maps)))
            mapped.append(item)
        except MappingError:
            continue
    refused = len(pairs) - len(maps)
    warnings: tuple[str, ...] = ()
    coverage, ratios = 0.0, np.zeros(0)
    names = ("mean_error_m", "median_sigma_m", "median_ratio", "ratio_p99", "largest_ratio", "beyond_share")
    errors: dict[str, float | None] = dict.fromkeys(names)
    if maps:
        fused = mapper.fuse(maps)
        warnings = (*(line for item in maps for line in item.warnings), *fused.warnings)
        total = sum(int(np.count_nonzero(truth.ranges_m() < SCORED_TO_M)) for truth in truths_of(pairs, true_rig))
        truths = truths_of(mapped, true_rig)
        covered = zip(pixel_coverage(fused.cloud, truths), truths, strict=True)
        coverage = sum(int(np.count_nonzero(image[truth.ranges_m() < SCORED_TO_M])) for image, truth in covered) / total
        found = point_errors(fused.cloud, truths)
        near = found.range_m < SCORED_TO_M
        error_m, sigma_m = found.error_m[near], fused.cloud.sigma[found.index[near]].astype(np.float64)
        with np.errstate(divide="ignore"):
            ratios = error_m / (3.0 * sigma_m)
    if len(ratios):
        figures = (error_m.mean(), np.median(sigma_m), np.median(ratios), np.quantile(ratios, 0.99), ratios.max())
        errors = dict(zip(names, map(float, (*figures, (ratios > LIMIT).mean())), strict=True))
    honesty = Honesty.SILENT if (errors["beyond_share"] or 0.0) > LIMIT_SHARE else Honesty.STATED
    if warnings or refused:
        honesty = Honesty.SAID
    known = {"pairs": len(maps), "refused": refused, "warnings": list(warnings), "coverage": coverage}
    return known | errors | {"honesty": honesty.value}
