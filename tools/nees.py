"""NEES of the localiser's motion covariance by interval, per degree of freedom, on rendered and recorded drives.

    python tools/nees.py --seeds 8101 --out out/nees --kitti PATH

Drives of the scenarios in `config/simulation` are rendered into the folder, once; drive k has the seed `--seeds` + k.
Each is localised by the defaults. Stretches that share no pair and have no degraded pose are judged: the error of the
motion against the covariance that the steps give, velocity and rotation apart; 1 is consistent. The lower table has
the mean squared error over variance along and about the axes of RB at the start of the stretch. A recorded drive's
truth is taken as exact.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.rotation import matrix_from_quat, rotvec_from_matrix
from sfr_loc_map.geometry.transform import propagated_covariance, propagation
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import drive_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.localisation.localiser import Localiser

SCENARIOS = ("rocky", "rolling", "crater_rim", "flat", "low_sun", "sample")
PAIRS, SPEED_M_S = 80, 0.35  #: Of each drive: 14 m at most.
INTERVALS_M = (0.0, 1.0, 2.0, 5.0)  #: Least lengths of stretches; 0: single steps.
AXES = ("forward", "left", "up", "roll", "pitch", "yaw")


class Stretch(NamedTuple):
    """One stretch: NEES per degree of freedom of velocity and rotation, and squared error over variance by axis."""

    velocity: float
    rotation: float
    by_axis: np.ndarray


def rendered(scenario: str, seed: int, folder: Path) -> Path:
    """Return the folder of a drive, rendered where it is missing or not complete."""
    drive = folder / f"{scenario}-{seed}"
    settings = [f"drive.pairs={PAIRS}", f"drive.speed_m_s={SPEED_M_S}", "panorama.enabled=false"]
    command = [str(Path(sys.executable).with_name("sfr")), "simulate", f"config/simulation/{scenario}.yaml", str(drive)]
    command += ["--seed", str(seed), *(part for setting in settings for part in ("--set", setting))]
    if not (drive / "groundtruth.csv").is_file():
        subprocess.run(command, check=True)
    return drive


def stretches(path: Path) -> dict[float, list[Stretch]]:
    """Localise a drive; return its stretches that share no pair, by least length in metres."""
    source = drive_of(open_source(path))
    localiser, truth = Localiser(source.rig, LocalisationConfig()), source.ground_truth
    assert truth is not None
    estimates = [localiser.process(pair) for pair in source.pairs()]
    estimates = [estimate for estimate in estimates if estimate.step is not None]
    degraded = sum(estimate.state is TrackingState.DEGRADED for estimate in estimates)
    print(f"{path}: {len(estimates)} poses, {degraded} degraded")
    rows = np.searchsorted(truth.stamps_ns, [estimate.stamp_ns for estimate in estimates])
    positions = truth.positions[rows]
    rotations = np.array([matrix_from_quat(quat) for quat in truth.quats_xyzw[rows]])
    result: dict[float, list[Stretch]] = {}
    for least in INTERVALS_M:
        start, found = 0, []
        for end in range(1, len(estimates)):
            if estimates[end].state is TrackingState.DEGRADED:
                start = end
                continue
            moved = estimates[end].T_ds_rb.translation - estimates[start].T_ds_rb.translation
            if np.linalg.norm(moved) >= least:
                found.append(judged(estimates[start : end + 1], positions[[start, end]], rotations[[start, end]]))
                start = end
        result[least] = found
    return result


def judged(estimates: list[PoseEstimate], positions: np.ndarray, rotations: np.ndarray) -> Stretch:
    """Return how the error over the poses compares to its covariance; truth `(2, 3)`, `(2, 3, 3)` at both ends."""
    first, last = estimates[0].T_ds_rb, estimates[-1].T_ds_rb
    to_start = first.rotation.T
    error = to_start @ (last.translation - first.translation) - rotations[0].T @ (positions[1] - positions[0])
    turn = (to_start @ last.rotation) @ (rotations[0].T @ rotations[1]).T
    error = np.concatenate((error, rotvec_from_matrix(turn)))
    covariance, systematic = np.zeros((6, 6)), np.zeros((6, 6))
    for before, now in pairwise(estimates):
        lever = to_start @ (last.translation - now.T_ds_rb.translation)
        axes = to_start @ before.T_ds_rb.rotation
        covariance += propagated_covariance(now.step.covariance, lever, axes)
        systematic += propagation(lever) @ np.kron(np.eye(2), axes) @ np.diag(now.step.systematic)
    covariance += propagated_covariance(estimates[0].step.noise, to_start @ (last.translation - first.translation))
    covariance += propagated_covariance(estimates[-1].step.noise, np.zeros(3), to_start @ last.rotation)
    covariance += systematic @ systematic.T
    velocity, rotation = (
        float(error[part] @ np.linalg.solve(covariance[part, part], error[part])) / 3
        for part in (slice(3), slice(3, 6))
    )
    return Stretch(velocity, rotation, error**2 / np.diag(covariance))


def main() -> None:
    """Render, localise, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8101, help="seed of the first drive")
    parser.add_argument("--drives", type=int, default=12)
    parser.add_argument("--out", type=Path, default=Path("out/nees"))
    parser.add_argument("--kitti", type=Path, help="a recorded drive with truth; skipped where it is absent")
    args = parser.parse_args()
    names = [(SCENARIOS[k % len(SCENARIOS)], args.seeds + k) for k in range(args.drives)]
    drives = {f"{scenario} {seed}": rendered(scenario, seed, args.out) for scenario, seed in names}
    found = {name: stretches(path) for name, path in drives.items()}
    if found:
        found = {"all rendered": {m: [s for drive in found.values() for s in drive[m]] for m in INTERVALS_M}} | found
    if args.kitti is not None and args.kitti.is_dir():
        found["recorded"] = stretches(args.kitti)
    titles = ["step" if metres == 0.0 else f"{metres:g} m" for metres in INTERVALS_M]
    print("NEES per degree of freedom of velocity, rotation, (count of stretches)")
    print("| drive | " + " | ".join(titles) + " |\n|" + "---|" * (len(titles) + 1))
    for name, of in found.items():
        cells = (mean_of(of[metres]) for metres in INTERVALS_M)
        print(f"| {name} | " + " | ".join(cells) + " |")
    print("\n| drive, interval | " + " | ".join(AXES) + " |\n|" + "---|" * (len(AXES) + 1))
    for name in ("all rendered", "recorded"):
        for metres, title in zip(INTERVALS_M, titles, strict=True):
            if judged_here := found.get(name, {}).get(metres):
                ratios = np.mean([stretch.by_axis for stretch in judged_here], axis=0)
                print(f"| {name}, {title} | " + " | ".join(f"{ratio:.2f}" for ratio in ratios) + " |")


def mean_of(of: list[Stretch]) -> str:
    """Return the means of stretches and their count, a cell of a table."""
    if not of:
        return "-"
    return f"{np.mean([s.velocity for s in of]):.2f}, {np.mean([s.rotation for s in of]):.2f} ({len(of)})"


if __name__ == "__main__":
    main()
