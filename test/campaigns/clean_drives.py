"""False alarms of `sfr check` on clean rendered drives: `python -m campaigns clean-drives [--drives 100] [--seed N]`.

Drives of 5 m of the scenarios in config/simulation are rendered with consecutive seeds, and checked without their
truth. With images of half the size (`--width 256`), a drive takes a quarter of the time. An inconsistent result is a
false alarm. The last lines are the number of false alarms with its 95 % interval, and the rank correlation of the lower
bound of the error with the true error. Rendered drives are kept in the folder and used again.
"""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest, spearmanr

from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.evidence.check import check_drive
from sfr_loc_map.evidence.check_result import Check, CheckResult
from sfr_loc_map.evidence.localiser_runs import ComparedRun, PairsInMemory, RunVariant, run_variant
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import drive_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.simulate import simulate

SCENARIOS = ("flat", "rolling", "rocky", "low_sun", "crater_rim", "stop_and_go")
DRIVE = {"pairs": 36, "speed_m_s": 0.3}  #: Settings that differ from those of the scenario: a drive of about 5 m.
FULL_WIDTH, FULL_FOCAL_PX = 512, 402.0  #: Width of the images, which are square, and focal length, in px.
CONDITIONS = (Condition.parse("distance=1"), Condition.parse("distance=2"))
JUDGED = "distance=2"
MOST_PAIRS = 200


class Checked(NamedTuple):
    """Result of a check and the true error of the forward run, in metres; NaN without a value."""

    result: CheckResult
    bound_m: float
    error_m: float


def main(arguments: list[str]) -> int:
    """Render and check the drives; exit code 1 if the fraction of false alarms exceeds 5 % beyond chance."""
    parser = argparse.ArgumentParser(prog="python -m campaigns clean-drives")
    parser.add_argument("--drives", type=int, default=100)
    parser.add_argument("--seed", type=int, default=20000)
    parser.add_argument("--width", type=int, default=FULL_WIDTH, help="width and height of the images, px")
    parser.add_argument("--folder", type=Path, default=Path("out/clean_drives"))
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args(arguments)
    checked = []
    for seed in range(given.seed, given.seed + given.drives):
        scenario = SCENARIOS[seed % len(SCENARIOS)]
        folder = given.folder / f"{scenario}-{seed}"
        if not folder.exists():
            simulate(config_of(scenario, seed, given.width), folder, given.workers)
        checked.append(check(folder))
    return summarise(checked)


def config_of(scenario: str, seed: int, width: int) -> SimulationConfig:
    """Return the configuration of a scenario with a seed, DRIVE, and images of `width` x `width` px and its view."""
    settings = load_yaml(Path("config/simulation") / f"{scenario}.yaml") | {"seed": seed}
    camera = {"width": width, "height": width, "focal_px": FULL_FOCAL_PX * width / FULL_WIDTH}
    for group, values in {"loc": camera, "drive": DRIVE}.items():
        settings[group] = settings.get(group, {}) | values
    return build(SimulationConfig, settings)


def check(folder: Path) -> Checked:
    """Check a drive without its truth, compare with its truth, and print one line."""
    drive = drive_of(open_source(folder))
    checked = PairsInMemory(drive.rig, list(islice(drive.pairs(), MOST_PAIRS)))
    forward = run_variant(checked, LocalisationConfig(), RunVariant.FORWARD, lambda: None)
    found = check_drive(drive, LocalisationConfig(), CONDITIONS, MOST_PAIRS)
    bound_m = largest_bound(found)
    error_m = true_error(forward, drive.ground_truth)
    known = [row for row in found.figures if row.figure == "agreement" and row.value is not None]
    worst = min(known, key=lambda row: row.value, default=None)
    shown = "" if worst is None else f"{worst.part} over {worst.condition}, p {worst.value:.2g}"
    print(
        f"{folder.name}; {found.results['drive']}; {shown}; at least {1e3 * bound_m:.2f} mm; "
        f"true rmse {1e3 * error_m:.2f} mm; "
        f"{int(forward.estimates.lost.sum())} lost; "
        f"{'; '.join(found.calibration) or 'calibration: nothing'}",
        flush=True,
    )
    return Checked(found.results["drive"], bound_m, error_m)


def largest_bound(found: Check) -> float:
    """Return the largest lower bound of the error over JUDGED, in metres; NaN if there is none."""
    rows = [row.value for row in found.figures if row.figure == "error_at_least" and row.condition == JUDGED]
    return max((value for value in rows if value is not None), default=float("nan"))


def true_error(forward: ComparedRun, truth: Trajectory) -> float:
    """Return the RMSE of the position of the forward run over JUDGED, in metres; NaN if there is none."""
    scored = score_trajectory(forward.estimates, truth, TrajectoryScoreConfig(conditions=(JUDGED,)))
    return Score(figures=scored.figures, association=scored.association).number("position", "rmse") or float("nan")


def summarise(checked: list[Checked]) -> int:
    """Print the number of each result, the false alarms and the rank correlation; return the exit code."""
    for result in CheckResult:
        count = sum(item.result is result for item in checked)
        print(f"{result}: {count} of {len(checked)} drives")
    judged = [item for item in checked if item.result is not CheckResult.NOT_ENOUGH_DATA]
    alarms = sum(item.result is CheckResult.INCONSISTENT for item in judged)
    test = binomtest(alarms, max(len(judged), 1), 0.05, alternative="greater")
    interval = binomtest(alarms, max(len(judged), 1)).proportion_ci(0.95, "exact")
    of_chance = f"95 % interval {interval.low:.3f} to {interval.high:.3f}"
    print(f"false alarms: {alarms} of {len(judged)} judged drives, {of_chance}")
    known = np.array([(item.bound_m, item.error_m) for item in checked if np.isfinite(item.bound_m + item.error_m)])
    if len(known) > 2:
        print(f"rank correlation of bound and error over {len(known)} drives: {spearmanr(*known.T).statistic:.2f}")
    return int(test.pvalue < 0.05)
