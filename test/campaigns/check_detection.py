"""Detection of faults by `sfr check`, one line per fault: `python -m campaigns check-detection SRC ...`.

Each drive with ground truth is checked unchanged and with each injected fault. The lower bound of the error from the
check is compared with the true error of the forward run. The last line is the rank correlation of both. The results are
in docs/measurements.md.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from scipy.stats import spearmanr

from sfr_loc_map.evidence.check import check_drive
from sfr_loc_map.evidence.check_result import DRIVE
from sfr_loc_map.evidence.localiser_runs import PairsInMemory, RunVariant, run_variant
from sfr_loc_map.faults.injector import FaultInjector
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import drive_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory

FAULTS = (
    *("", "noisy:amount=10,share=1", "blurred:amount=2.5,share=1", "yaw:amount=0.1", "baseline:amount=1.005"),
    *("dropped:share=0.1", "shear:amount=1,share=1"),
)
"""Faults of the detection table; the empty text is not a fault."""
CONDITIONS = (Condition.parse("distance=1"), Condition.parse("distance=5"))
JUDGED = "distance=5"
MOST_PAIRS = 110  #: About 8 to 10 m of the rendered drives.


def main(arguments: list[str]) -> int:
    """Print the result of the check for each drive and fault."""
    bounds, errors = [], []
    for path in map(Path, arguments):
        drive = drive_of(open_source(path))
        truth = drive.ground_truth
        clean = list(islice(drive.pairs(), MOST_PAIRS))
        for text in FAULTS:
            faults = [parse_fault(text)] if text else []
            injector = FaultInjector(faults, 1, len(clean), drive.rig)
            kept = [pair for _, pair in injector.pairs(clean)]
            sequence = PairsInMemory(injector.rig, kept)
            found = check_drive(sequence, LocalisationConfig(), CONDITIONS, MOST_PAIRS)
            forward = run_variant(sequence, LocalisationConfig(), RunVariant.FORWARD, lambda: None)
            known = [row for row in found.figures if row.figure == "agreement" and row.value is not None]
            worst = min(known, key=lambda row: row.value, default=None)
            least = [row.value for row in found.figures if row.figure == "error_at_least" and row.condition == JUDGED]
            bound = max((value for value in least if value is not None), default=float("nan"))
            scored = score_trajectory(forward.estimates, truth, TrajectoryScoreConfig(conditions=(JUDGED,)))
            error = Score(figures=scored.figures, association=scored.association).number("position", "rmse") or float(
                "nan"
            )
            shown = "" if worst is None else f"{worst.part} over {worst.condition}, p {worst.value:.2g}"
            closures = "; ".join(
                f"misclosure {1e3 * row.value:.2f} mm of {row.part}"
                for row in found.figures
                if row.figure == "misclosure" and row.value is not None
            )
            lost = int(forward.estimates.lost.sum())
            print(
                f"{path.name}; {text or 'none'}; {found.results[DRIVE]}; {shown}; at least {1e3 * bound:.2f} mm; "
                f"true rmse {1e3 * error:.2f} mm; {lost} lost; {closures or 'no revisited place'}; "
                f"{'; '.join(found.calibration) or 'calibration: nothing'}",
                flush=True,
            )
            bounds.append(bound)
            errors.append(error)
    print(f"rank correlation of bound and error over {len(bounds)} runs: {spearmanr(bounds, errors).statistic:.2f}")
    return 0
