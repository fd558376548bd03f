"""`sfr check`: what a recording shows of its own localisation, without ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.options import (
    ConfigOption,
    JsonOption,
    LenientOption,
    OverwriteOption,
    RemapOption,
    SourceArgument,
    open_as,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, check_outputs, progress_bar, say, show
from sfr_loc_map.cli.verdict import not_judged
from sfr_loc_map.config import read_config
from sfr_loc_map.errors import ConfigError, FailedVerdictError, naming
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.config import Condition

CONDITIONS = ("distance=1", "distance=5")


@app.command(
    epilog=examples(
        "sfr check drive.mcap",
        "sfr check data/ --condition distance=2 --json check.json",
        "sfr check drive.mcap --estimate wheels.csv --estimate other.csv",
    )
)
def check(
    source: SourceArgument,
    condition: Annotated[
        list[str] | None, Option(metavar="KIND=VALUE", help="What ends a sub-trajectory; distance=1 and distance=5.")
    ] = None,
    estimate: Annotated[
        list[Path] | None, Option(metavar="T.csv", help="Another estimate of the drive, one or two.")
    ] = None,
    pairs: Annotated[
        int, Option(min=20, metavar="N", help="Maximum number of pairs that are kept in memory and run.")
    ] = 600,
    config: ConfigOption = None,
    remap: RemapOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Say whether runs over a recording agree as their covariances predict; no ground truth is needed.

    It shows that something is wrong, or a lower bound of the error. It never shows that an accuracy is met: what all
    runs share, as the calibration, stays hidden.
    """
    from sfr_loc_map.evidence.agreement import PLACES, CheckResult
    from sfr_loc_map.evidence.calibration import calibration_table
    from sfr_loc_map.evidence.check import check_drive, check_table, hat_table
    from sfr_loc_map.evidence.predicted import predicted_table
    from sfr_loc_map.evidence.revisited import closure_table
    from sfr_loc_map.evidence.variants import Run, Variant
    from sfr_loc_map.io.sequence import drive_of
    from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
    from sfr_loc_map.metrics.association import Estimates
    from sfr_loc_map.metrics.score_json import to_plain

    check_outputs(json_path, inputs=(source, config), overwrite=overwrite)
    if len(estimate or ()) > 2:
        raise ConfigError("'--estimate': give one or two others, our own run is the third")
    conditions = [Condition.parse(text) for text in condition or CONDITIONS]
    opened, read_from = open_as(source, remap, config)
    parameters, sequence = read_config(LocalisationConfig, read_from, "localisation"), drive_of(opened)
    others = [Run(path.name, Estimates.of(read_trajectory_file(path).trajectory)) for path in estimate or ()]
    with naming(source), progress_bar("pairs") as bar:
        count = min(len(sequence), pairs)
        task = bar.add_task("checking", total=count * len(Variant) - count // 2)
        found = check_drive(sequence, parameters, conditions, pairs, others, lambda: bar.advance(task))
    content = {
        "schema": "sfr-check/1",
        "result": found.result.value,
        "calibration": list(found.calibration),
        "figures": to_plain(found.figures),
    }
    tables = (
        check_table(found),
        closure_table(found.figures),
        predicted_table(found.figures),
        hat_table(found),
        calibration_table(found.figures),
    )
    show(content, json_path, [table for table in tables if table.rows])
    say(
        f"check: {found.result}. This is no accuracy: what all runs share does not show",
        err=json_path == STANDARD_OUTPUT,
    )
    for text in found.calibration:
        say(f"calibration: {text}", err=json_path == STANDARD_OUTPUT)
    if found.result is CheckResult.INCONSISTENT:
        known = [item for item in found.agreements if item.probability is not None]
        worst = min(known, key=lambda item: item.probability or 0.0)
        over = worst.condition or PLACES
        differing = f"{worst.name} over {over} differ by more than their covariances predict"
        raise FailedVerdictError(f"{differing} (p {worst.probability:.2g})")
    if found.calibration:
        raise FailedVerdictError("the calibration does not fit the recording: each offset is named above")
    if found.result is CheckResult.NOT_ENOUGH_DATA:
        not_judged(["fewer than three sub-trajectories: give a smaller --condition"], lenient=lenient)
