"""NEES per degree of freedom of the localiser's motion covariance, by interval, on rendered and recorded drives.

    python tools/nees.py --seeds 8101 --out out/nees --kitti PATH

Drives of the scenarios in `config/simulation` are rendered into the folder, unless they exist; drive k has the seed
`--seeds` + k. Each drive is localised with the default parameters. Disjoint intervals without degraded poses are
evaluated: the error of the motion against the covariance from the steps, separately for translation and rotation. A
NEES of 1 is consistent. The lower table has the mean of squared error over variance along and about the axes of RB at
the start of the interval. The ground truth of a recorded drive is assumed to be exact. `--figure` draws the upper
table.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib import pyplot as plt

from sfr_loc_map.calls.call_poses import estimates_of
from sfr_loc_map.calls.growing_calls import stats_of
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import drive_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.frames.association import associate
from sfr_loc_map.metrics.trajectory.consistency import relative_covariance, relative_errors, sums_of_steps
from sfr_loc_map.runs.drive_start import start_pose
from sfr_loc_map.runs.localiser_run import localise, trajectory_of

SCENARIOS = ("rocky", "rolling", "crater_rim", "flat", "low_sun", "sample")
PAIRS, SPEED_M_S = 80, 0.35  #: Pairs and speed of each drive, at most 14 m.
INTERVALS_M = (0.0, 1.0, 2.0, 5.0)  #: Smallest lengths of the intervals, m; 0 for single steps.
AXES = ("forward", "left", "up", "roll", "pitch", "yaw")


class Stretch(NamedTuple):
    """NEES per degree of freedom of translation (`velocity`) and rotation of an interval, and the ratios by axis."""

    velocity: float
    rotation: float
    by_axis: FloatArray


def rendered(scenario: str, seed: int, folder: Path) -> Path:
    """Return the folder of a drive, which is rendered if it is missing or incomplete."""
    drive = folder / f"{scenario}-{seed}"
    settings = [f"drive.pairs={PAIRS}", f"drive.speed_m_s={SPEED_M_S}", "panorama.enabled=false"]
    command = [str(Path(sys.executable).with_name("sfr")), "simulate", f"config/simulation/{scenario}.yaml", str(drive)]
    command += ["--seed", str(seed), *(part for setting in settings for part in ("--set", setting))]
    if not (drive / "groundtruth.csv").is_file():
        subprocess.run(command, check=True)
    return drive


def stretches(path: Path) -> dict[float, list[Stretch]]:
    """Localise a drive; return disjoint intervals by their smallest length, m."""
    source = drive_of(open_source(path))
    truth = source.ground_truth
    assert truth is not None
    found, calls = zip(*localise(source, LocalisationConfig(), start_pose(source, "truth")), strict=True)
    estimates = estimates_of(trajectory_of(found), stats_of(calls))
    assert estimates.steps is not None
    print(f"{path}: {len(calls)} poses, {np.count_nonzero(estimates.degraded)} degraded")
    frames, _ = associate(estimates.trajectory, truth, AssociationConfig())
    sums = sums_of_steps(estimates, estimates.steps, frames.estimate_rows)
    result: dict[float, list[Stretch]] = {}
    for least in INTERVALS_M:
        start, result[least] = 0, []
        for end in range(1, len(frames.estimate_rows)):
            first, last = (int(frames.estimate_rows[k]) for k in (start, end))
            if estimates.degraded[last] or estimates.lost[last]:
                start = end
            elif np.linalg.norm(frames.position[end] - frames.position[start]) >= least:
                covariance = relative_covariance(sums[first], sums[last], frames.position[end])
                if covariance is not None:
                    to_start = np.kron(np.eye(2), matrix_from_quat(frames.attitude[start]).T)
                    ends = np.array([start]), np.array([end])
                    error = to_start @ relative_errors(frames.estimate, frames.truth, *ends)[0]
                    result[least].append(judged(error, to_start @ covariance @ to_start.T))
                start = end
    return result


def judged(error: FloatArray, covariance: FloatArray) -> Stretch:
    """Compare an error `(6,)` with its covariance `(6, 6)`."""
    velocity, rotation = (
        float(error[part] @ np.linalg.solve(covariance[part, part], error[part])) / 3
        for part in (slice(3), slice(3, 6))
    )
    return Stretch(velocity, rotation, error**2 / np.diag(covariance))


def draw(found: dict[str, dict[float, list[Stretch]]], path: Path) -> None:
    """Draw NEES over the interval: each rendered drive, all rendered drives, and the recorded drive."""
    plt.rcParams |= {"font.size": 8, "axes.spines.top": False, "axes.spines.right": False, "svg.hashsalt": "nees"}
    figure, axes = plt.subplots(1, 2, figsize=(6.5, 2.6), sharey=True, layout="constrained")
    looks = {"all rendered": {"color": "k", "lw": 2.0}, "recorded": {"color": "tab:red", "ls": "--"}}
    for axis, part in zip(axes, ("velocity", "rotation"), strict=True):
        axis.axhspan(0.5, 2.0, color="0.92")
        for name, of in found.items():
            means = [np.mean([getattr(stretch, part) for stretch in of[m]]) if of[m] else np.nan for m in INTERVALS_M]
            axis.plot(range(len(means)), means, marker=".", **looks.get(name, {"color": "0.7", "lw": 0.7, "zorder": 1}))
        axis.set_xticks(range(len(INTERVALS_M)), ["step", *(f"{m:g} m" for m in INTERVALS_M[1:])])
        axis.set(yscale="log", xlabel=f"interval: {part}")
    axes[0].set_ylabel("NEES per degree of freedom")
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Render and localise the drives, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8101, help="seed of the first drive")
    parser.add_argument("--drives", type=int, default=12)
    parser.add_argument("--out", type=Path, default=Path("out/nees"))
    parser.add_argument("--kitti", type=Path, help="a recorded drive with ground truth; skipped if missing")
    parser.add_argument("--figure", type=Path, help="an SVG to write")
    args = parser.parse_args()
    names = [(SCENARIOS[k % len(SCENARIOS)], args.seeds + k) for k in range(args.drives)]
    drives = {f"{scenario} {seed}": rendered(scenario, seed, args.out) for scenario, seed in names}
    found = {name: stretches(path) for name, path in drives.items()}
    if found:
        found = {"all rendered": {m: [s for drive in found.values() for s in drive[m]] for m in INTERVALS_M}} | found
    if args.kitti is not None and args.kitti.is_dir():
        found["recorded"] = stretches(args.kitti)
    if args.figure is not None:
        draw(found, args.figure)
    titles = ["step" if metres == 0.0 else f"{metres:g} m" for metres in INTERVALS_M]
    print("NEES per degree of freedom: velocity, rotation (number of intervals)")
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
    """Return a table cell: the mean NEES of translation and rotation, and the number of intervals."""
    if not of:
        return "-"
    return f"{np.mean([s.velocity for s in of]):.2f}, {np.mean([s.rotation for s in of]):.2f} ({len(of)})"


if __name__ == "__main__":
    main()
