"""`sfr check`: consistency of the localisation and the maps of a recording, without ground truth."""

from __future__ import annotations

from collections.abc import Sequence
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


def names_of_estimates(paths: Sequence[Path]) -> dict[Path, str]:
    """Return the names of the runs of estimates: the names of their files, or the paths if files have the same name."""
    if len(set(paths)) < len(paths):
        raise ConfigError(f"'--estimate {paths[0]}' is given twice: give different estimates")
    has_equal_names = len({path.name for path in paths}) < len(paths)
    return {path: str(path) if has_equal_names else path.name for path in paths}


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
        list[str] | None, Option(metavar="KIND=VALUE", help="End of a sub-trajectory; default: distance=1, distance=5.")
    ] = None,
    estimate: Annotated[
        list[Path] | None, Option(metavar="T.csv", help="Another estimate of the drive; at most two.")
    ] = None,
    pairs: Annotated[
        int, Option(min=20, metavar="N", help="Maximum number of pairs that are held in memory and processed.")
    ] = 600,
    config: ConfigOption = None,
    remap: RemapOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Check whether runs over a drive, and maps of several pairs, agree as predicted, without ground truth.

    The check detects errors or gives a lower bound of the error. It never proves an accuracy, because errors that all
    runs share, such as those of the calibration, stay hidden.
    """
    from sfr_loc_map.evidence.calibration import Advice
    from sfr_loc_map.evidence.check import check_drive, check_tables
    from sfr_loc_map.evidence.check_result import Check, CheckResult, worst_result
    from sfr_loc_map.evidence.overlap import check_maps
    from sfr_loc_map.evidence.variants import Run, calls_of
    from sfr_loc_map.io.sequence import drive_of
    from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.mapping.multiview.projection import MIN_OVERLAP
    from sfr_loc_map.metrics.association import Estimates
    from sfr_loc_map.metrics.score_json import to_plain

    check_outputs(json_path, inputs=(source, config), overwrite=overwrite)
    if len(estimate or ()) > 2:
        raise ConfigError("'--estimate': give at most two estimates; our own run is the third")
    names = names_of_estimates(estimate or ())
    conditions = list(dict.fromkeys(Condition.parse(text) for text in condition or CONDITIONS))
    opened, read_from = open_as(source, remap, config)
    checks: dict[str, Check] = {}
    calibration: list[str] = []
    advice: dict[str, Advice] = {}
    has_maps = opened.nav is not None and len(opened.nav) > 1
    if opened.loc is not None or not has_maps:
        parameters, sequence = read_config(LocalisationConfig, read_from, "localisation"), drive_of(opened)
        others = [Run(names[path], Estimates.of(read_trajectory_file(path).trajectory)) for path in names]
        with naming(source), progress_bar("pairs") as bar:
            count = min(len(sequence), pairs)
            task = bar.add_task("checking", total=calls_of(count))
            drive = check_drive(sequence, parameters, conditions, pairs, others, lambda: bar.advance(task))
        checks["drive"] = drive
        calibration = [offset.text for offset in drive.wrong_offsets]
        advice = drive.advice
    if opened.nav is not None and has_maps:
        with naming(source):
            checks["maps"] = check_maps(opened.nav, read_config(MappingConfig, read_from, "mapping"))
    results = {subject: item.result for subject, item in checks.items()}
    figures = tuple(row for item in checks.values() for row in item.figures)
    content = {
        "schema": "sfr-check/1",
        "result": worst_result(results.values()).value,
        "results": {subject: result.value for subject, result in results.items()},
        "calibration": calibration,
        "advice": advice,
        "figures": to_plain(figures),
    }
    show(content, json_path, check_tables(figures, advice))
    is_silent = json_path == STANDARD_OUTPUT
    for subject, result in results.items():
        say(f"{subject}: {result}. This proves no accuracy: errors that all runs share stay hidden", err=is_silent)
    for text in calibration:
        say(f"calibration: {text}", err=is_silent)
    if disagreements := [text for item in checks.values() for text in item.disagreements]:
        raise FailedVerdictError("; ".join(disagreements))
    if calibration:
        raise FailedVerdictError("the calibration does not fit the recording: each offset is named above")
    few = {
        "drive": "fewer than three sub-trajectories and no revisited place: give a smaller --condition",
        "maps": f"no two mapping pairs have {MIN_OVERLAP} points in common",
    }
    not_judged(
        [few[subject] for subject, result in results.items() if result is CheckResult.NOT_ENOUGH_DATA], lenient=lenient
    )
