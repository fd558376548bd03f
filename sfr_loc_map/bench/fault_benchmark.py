"""Our localiser on one drive with one fault at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby, pairwise
from typing import Final

import numpy as np

from sfr_loc_map.bench.figures import JsonObject
from sfr_loc_map.bench.honesty import LIMIT, Honesty, StatedErrors, stated_errors
from sfr_loc_map.bench.results import SCHEMA
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.convert import FaultyLoc
from sfr_loc_map.pipeline.offline import localise, start_pose, trajectory_of
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
    "drift",
    "start",
    "fade",
    "frozen",
    "frozen:camera=right",
    "torn",
    "identical",
    "saturation:share=0.3",
    "body",
    "object:share=0.2",
    "dirt",
    "shadow",
)
"""Faults of real rovers; 0.06 deg of rotation of the right camera is about half a pixel at 512 px and 60 deg."""
JUMP_SIGMA: Final = 3.0


@dataclass(frozen=True, slots=True)
class FaultFigures:
    """Figures of the localiser on one drive; errors are those of the pairs that are not reported as lost.

    Attributes:
        pairs: Number of pairs.
        position_m: Mean + 3 sigma of the position error over sub-trajectories, metres.
        heading_deg: Mean + 3 sigma of the heading error, degrees.
        lost: Number of pairs reported as lost.
        longest_lost: Most lost pairs in a row.
        silent_jumps: Number of pairs not reported as lost whose motion since the last such pair is wrong by more than
            three times the stated standard deviation of the position at either end.
        largest_jump_sigma: Largest such error over that standard deviation.
        vertical_offset_px: Vertical disparity at the end, as the online calibration estimates it.
        disparity_offset_px: Disparity offset at the end, likewise.
        stated: Errors of single poses over what is stated.
    """

    pairs: int
    position_m: float | None
    heading_deg: float | None
    lost: int
    longest_lost: int
    silent_jumps: int
    largest_jump_sigma: float | None
    vertical_offset_px: float | None
    disparity_offset_px: float | None
    stated: StatedErrors

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        figures: JsonObject = asdict(self)
        del figures["stated"]
        return figures | asdict(self.stated) | {"honesty": self.stated.honesty.value}


@dataclass(frozen=True, slots=True)
class FaultComparison:
    """Result of the benchmark of faults.

    Attributes:
        condition: End of a sub-trajectory.
        seed: Seed of which pairs are affected.
        entries: Figures by fault; `none` is the drive without.
    """

    condition: str
    seed: int
    entries: Mapping[str, FaultFigures]

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        entries = {name: figures.to_json() for name, figures in self.entries.items()}
        head: JsonObject = {"schema": SCHEMA, "kind": "faults", "condition": self.condition, "seed": self.seed}
        return head | {"limit": LIMIT, "entries": entries, "missing": {}}

    @property
    def silent(self) -> list[str]:
        """Faults with a pair beyond the limit that was called tracking."""
        return [name for name, figures in self.entries.items() if figures.stated.honesty is Honesty.SILENT]


def benchmark_faults(
    sequence: LocSequence,
    faults: Sequence[str],
    config: LocalisationConfig,
    scoring: TrajectoryScoreConfig,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> FaultComparison:
    """Return the figures of the localiser on a drive without and with each fault.

    Args:
        sequence: A drive with its ground truth.
        faults: Each a text for `parse_fault`, or several joined by `+`.
        config: Parameters of the localiser.
        scoring: Sub-trajectories; the first condition is shown.
        seed: Seed of which pairs are affected.
        progress: Called with the name of each fault when it is done.

    Raises:
        ConfigError: If a fault is not known.
    """
    parsed: dict[str, list[Fault]] = {"none": []}
    parsed |= {text: [parse_fault(part) for part in text.split("+")] for text in faults}
    entries = {}
    for name, injected in parsed.items():
        drive = FaultyLoc(sequence, injected, seed)
        estimates = [estimate for estimate, _ in localise(drive, config, start_pose(sequence, "truth"))]
        entries[name] = fault_figures(estimates, sequence.ground_truth, scoring)
        progress(name)
    return FaultComparison(scoring.conditions[0], seed, entries)


def fault_figures(
    estimates: Sequence[PoseEstimate], truth: Trajectory | None, scoring: TrajectoryScoreConfig
) -> FaultFigures:
    """Return the figures of one drive from its estimates."""
    assert truth is not None
    lost = [estimate.state is TrackingState.LOST for estimate in estimates]
    known = [estimate for estimate, gone in zip(estimates, lost, strict=True) if not gone]
    scored = score_trajectory(Estimates.of(trajectory_of(known)), truth, scoring).score.first if known else None
    jumps = jump_sigmas(known, truth)
    last = estimates[-1].statistics
    return FaultFigures(
        pairs=len(estimates),
        position_m=None if scored is None else scored.position_m.mean_plus_3sigma,
        heading_deg=None if scored is None else scored.heading_deg.mean_plus_3sigma,
        lost=sum(lost),
        longest_lost=max((len(list(run)) for gone, run in groupby(lost) if gone), default=0),
        silent_jumps=int(np.count_nonzero(jumps > JUMP_SIGMA)),
        largest_jump_sigma=float(jumps.max()) if len(jumps) else None,
        vertical_offset_px=last.vertical_offset_px,
        disparity_offset_px=last.disparity_offset_px,
        stated=stated_errors(estimates, truth),
    )


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
