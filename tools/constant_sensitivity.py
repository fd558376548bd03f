"""Sensitivity of the localiser's errors to single constants.

    .venv/bin/python tools/constant_sensitivity.py SRC... [--only NAME]

For each value, the tool prints the root mean square errors of position and attitude over all sub-trajectories of 2 m,
and the processor time. All are ratios to the run with the values in the source, as geometric means over the drives.
Only constants that are read at each call can be changed, but not those of compiled kernels. The figures of a single
drive vary by 20 % with any small change of the code (`measurements/localiser_trials.md`).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import LocSequence, drive_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.tracking import LIMITS
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.motion_size import size_of
from sfr_loc_map.runs.drive_start import start_pose

PAIRS = 120  #: Largest number of pairs of a drive.
SUB_TRAJECTORY_M = 2.0
VALUES: dict[str, tuple[object, ...]] = {
    "frontend.tracking.LIMITS": (
        LIMITS._replace(max_shift=1.5),
        LIMITS._replace(max_shift=4.0),
        LIMITS._replace(iterations=4),
        LIMITS._replace(iterations=10),
        LIMITS._replace(min_correlation=0.4),
        LIMITS._replace(min_correlation=0.8),
    ),
    "frontend.tracking.ALIGNMENT_ITERATIONS": ((3, 2), (12, 8)),
    "frontend.tracking.POSE_ITERATIONS": (5, 20),
    "frontend.tracking.INLIER_CHI2_PER_DOF": (4.0, 16.0),
    "frontend.noise.RESIDUAL_GAIN": (0.8, 1.8),
    "frontend.row_search.SEARCH_HALF": (3, 6),
    "frontend.row_search.MIN_SEARCH_NCC": (0.6, 0.9),
    "frontend.row_search.MAX_AMBIGUITY": (0.7, 1.0),
    "frontend.neighbour_slopes.NEIGHBOURS": (6, 14),
    "frontend.stereo_matching.REFINEMENTS": (1, 3),
    "frontend.stereo_matching.MAX_SHIFT_PX": (1.5, 4.0),
    "frontend.stereo_matching.ITERATIONS": (6, 24),
    "frontend.stereo_matching.MIN_NCC": (0.5, 0.85),
    "frontend.stereo_matching.MAX_VERTICAL_PX": (0.5, 2.0),
    "frontend.feature_detection.MIN_DISTANCE_RATIO": (0.4, 0.8),
    "frontend.feature_detection.MIN_STRENGTH_RATIO": (0.01, 0.16),
    "keyframes.KEYFRAME_INLIER_RATIO": (0.5, 0.8),
}


class Errors(NamedTuple):
    """Root mean square errors of sub-trajectories, and the processor time per pair."""

    position_m: float
    attitude_rad: float
    seconds: float


def run(drive: LocSequence) -> Errors:
    """Localise a drive and return the errors."""
    localiser = Localiser(drive.rig, LocalisationConfig(), start_pose(drive, "truth"))
    truth = drive.ground_truth
    if truth is None:
        raise SystemExit("a drive has no ground truth")
    pairs = list(islice(drive.pairs(), PAIRS))
    start = time.process_time()
    found = [localiser.process(pair).T_ds_rb for pair in pairs]
    seconds = (time.process_time() - start) / len(pairs)
    rows = np.searchsorted(truth.stamps_ns, [pair.stamp_ns for pair in pairs])
    true = [truth.pose(int(min(row, len(truth) - 1))) for row in rows]
    sizes = np.array(list(map(size_of, sub_trajectory_errors(true, found))))
    position_m, attitude_rad = np.sqrt(np.mean(np.square(sizes), axis=0))
    return Errors(float(position_m), float(attitude_rad), seconds)


def sub_trajectory_errors(true: Sequence[Transform], found: Sequence[Transform]) -> list[Transform]:
    """Return the errors of all sub-trajectories of `SUB_TRAJECTORY_M`."""
    steps = np.diff([pose.translation for pose in true], axis=0)
    travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(steps, axis=1))))
    ends = np.searchsorted(travelled, travelled + SUB_TRAJECTORY_M)
    errors = []
    for start, end in enumerate(ends):
        if end < len(true):
            motion = true[start].inverse() @ true[end]
            errors.append(motion.inverse() @ found[start].inverse() @ found[end])
    return errors


def main() -> None:
    """Print a row for each value of each constant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+")
    parser.add_argument("--only", default="", help="constants whose name contains this")
    options = parser.parse_args()
    drives = [drive_of(open_source(Path(source))) for source in options.sources]
    run(drives[0])  # compiles the kernels
    before = np.array([run(drive) for drive in drives])
    for name, values in VALUES.items():
        if options.only not in name:
            continue
        module_name, constant = name.rsplit(".", 1)
        module = import_module(f"sfr_loc_map.localisation.{module_name}")
        present = getattr(module, constant)
        for value in values:
            setattr(module, constant, value)
            ratio = np.exp(np.mean(np.log(np.array([run(drive) for drive in drives]) / before), axis=0))
            print(f"{name} {value}: position {ratio[0]:.2f} attitude {ratio[1]:.2f} time {ratio[2]:.2f}", flush=True)
        setattr(module, constant, present)


if __name__ == "__main__":
    main()
