"""The localiser on one drive with one fault after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby, pairwise
from typing import Any, Final

import numpy as np

from sfr_loc_map.bench.figures import SCHEMA, Figures
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.offline import localise, start_pose, trajectory_of
from sfr_loc_map.pipeline.perturb import FaultyLoc
from sfr_loc_map.simulation.faults import Fault, parse_fault

FAULTS: Final = (
    "dropped:share=0.2",
    "repeated:share=0.2",
    "swapped",
    "black",
    "black:burst=5",
    "black:camera=left",
    "black:camera=right,burst=5",
    "blinded:share=0.2",
    "blinded:share=0.2,camera=left",
    "blurred:share=0.3",
    "blurred:share=0.3,camera=right",
    "noisy:share=1",
    "exposure:share=0.3",
    "exposure:share=0.3,camera=right,amount=0.7",
    "roll:amount=0.1",
    "pitch:amount=0.06",
    "yaw:amount=0.03",
)
"""What rovers meet; a turn of the right camera of 0.06 deg is about half a pixel at 512 pixels and 60 degrees."""
JUMP_SIGMA: Final = 3.0


def bench_faults(
    sequence: LocSequence,
    faults: Sequence[str],
    config: LocalisationConfig,
    scoring: TrajectoryScoreConfig,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Return what the localiser says of a drive without and with each fault.

    Args:
        sequence: A drive with its truth.
        faults: Each a text for `parse_fault`, or several joined by `+`.
        config: Parameters of the localiser.
        scoring: Sub-trajectories; the first condition is shown.
        seed: Which pairs are struck.
        progress: Called with the name of each fault when it is done.

    Raises:
        ConfigError: If a fault is not known.
    """
    parsed: dict[str, list[Fault]] = {"none": []}
    parsed |= {text: [parse_fault(part) for part in text.split("+")] for text in faults}
    entries = {}
    for name, spoiled in parsed.items():
        drive = FaultyLoc(sequence, spoiled, seed)
        estimates = [estimate for estimate, _ in localise(drive, config, start_pose(sequence, "truth"))]
        entries[name] = fault_figures(estimates, sequence.ground_truth, scoring)
        progress(name)
    result = {"schema": SCHEMA, "kind": "faults", "condition": scoring.conditions[0], "seed": seed}
    return result | {"entries": entries, "missing": {}}


def fault_figures(
    estimates: Sequence[PoseEstimate], truth: Trajectory | None, scoring: TrajectoryScoreConfig
) -> Figures:
    """Return the figures of one drive; errors are those of the pairs that are not called lost.

    A silent jump is a pair that is not called lost and whose motion since the last such pair is wrong by more than
    three times the stated standard deviation of the position at either end.
    """
    assert truth is not None
    lost = [estimate.state is TrackingState.LOST for estimate in estimates]
    said = [estimate for estimate, gone in zip(estimates, lost, strict=True) if not gone]
    scored = score_trajectory(Estimates.of(trajectory_of(said)), truth, scoring)["trajectory"]
    part = scored.get("conditions", [scored])[0]
    jumps = jump_sigmas(said, truth)
    last = estimates[-1].statistics
    return {
        "pairs": len(estimates),
        "position_m": part["position_m"]["mean_plus_3sigma"],
        "heading_deg": part["heading_deg"]["mean_plus_3sigma"],
        "lost": sum(lost),
        "longest_lost": max((len(list(run)) for gone, run in groupby(lost) if gone), default=0),
        "silent_jumps": int(np.count_nonzero(jumps > JUMP_SIGMA)),
        "largest_jump_sigma": float(jumps.max()) if len(jumps) else None,
        **{name: last.get(name) for name in ("vertical_offset_px", "disparity_offset_px")},
    }


def jump_sigmas(estimates: Sequence[PoseEstimate], truth: Trajectory) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the error of each motion `(N - 1,)` over the larger of the standard deviations stated at its ends."""
    at = {int(stamp): index for index, stamp in enumerate(truth.stamps_ns)}
    pairs = [(estimate, truth.pose(at[estimate.stamp_ns])) for estimate in estimates if estimate.stamp_ns in at]
    sigmas = []
    for (before, true_before), (now, true_now) in pairwise(pairs):
        moved = true_before @ before.T_ds_rb.inverse() @ now.T_ds_rb
        error = np.linalg.norm(moved.translation - true_now.translation)
        # a motion is known no better than the less well known of its ends
        variance = max(float(np.trace(end.covariance[:3, :3])) for end in (before, now))
        sigmas.append(error / np.sqrt(variance))
    return np.array(sigmas)
