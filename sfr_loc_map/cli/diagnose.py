"""`sfr diagnose`: search for a convention mismatch between an estimate and its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.options import (
    AssociateOption,
    ColumnsOption,
    ConfigOption,
    FramesOption,
    JsonOption,
    LenientOption,
    MaxGapOption,
    OverwriteOption,
    TruthSettingsOption,
    config_of_truth,
    inputs_read_as,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, check_outputs, say, show
from sfr_loc_map.cli.verdict import not_judged
from sfr_loc_map.errors import FailedVerdictError

OF_COMPARISON = ("frames", "associate", "max_gap", "columns", "config_file", "settings")
"""Options of `sfr score` and `sfr diagnose` that determine which poses are compared."""


@app.command(epilog=examples("sfr diagnose estimate.csv data/", "sfr diagnose orbslam.tum truth.tum --frames images"))
def diagnose(
    estimate: Annotated[Path, Argument(metavar="EST", help="Trajectory (csv, TUM, KITTI, EuRoC, bag).")],
    truth: Annotated[Path, Argument(metavar="TRUTH", help="Trajectory, bag or data set.")],
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
    frames: FramesOption = "truth",
    associate: AssociateOption = "auto",
    max_gap: MaxGapOption = 1.0,
    columns: ColumnsOption = None,
    config_file: ConfigOption = None,
    settings: TruthSettingsOption = None,
) -> None:
    """Search for a convention mismatch that explains the disagreement of estimate and truth; exit 1 if one is found."""
    from sfr_loc_map.metrics.convention_diagnosis import MIN_POSES
    from sfr_loc_map.report.diagnosis_table import diagnosis_table
    from sfr_loc_map.scoring.conversion import diagnose_run
    from sfr_loc_map.scoring.inputs import ScoreInputs
    from sfr_loc_map.scoring.settings import score_settings

    check_outputs(json_path, inputs=(estimate, truth, config_file), overwrite=overwrite)
    inputs = inputs_read_as(
        ScoreInputs.of(estimate, truth, ()), truth, config_of_truth(truth, config_file), columns, settings
    )
    config = score_settings(None, frames=frames, associate=associate, max_gap=max_gap)
    diagnosis = diagnose_run(inputs, config)
    show(diagnosis, json_path, [diagnosis_table(diagnosis)])
    if diagnosis.found is not None:
        if json_path != STANDARD_OUTPUT:
            say(diagnosis.found.sentence)
            if diagnosis.found.setting:
                say(f"sfr score ... --convention {diagnosis.found.setting} corrects it")
        advice = f": score again with --convention {diagnosis.found.setting}" if diagnosis.found.setting else ""
        raise FailedVerdictError(f"estimate and truth use different conventions ({diagnosis.found.mismatch}){advice}")
    if diagnosis.disagreement is None:
        not_judged([f"'{estimate}' and '{truth}' have fewer than {MIN_POSES} stamps in common"], lenient=lenient)
    elif json_path != STANDARD_OUTPUT:
        say("no single convention mismatch explains the disagreement, if there is any")
