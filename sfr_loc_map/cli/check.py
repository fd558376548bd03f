"""`sfr check`: consistency of the localisation and the maps of a recording, without ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec.structs import replace
from typer import Context, Option

from sfr_loc_map.cli.app import app, command_line, examples
from sfr_loc_map.cli.options import (
    ConfigOption,
    JsonOption,
    LenientOption,
    OverwriteOption,
    RemapOption,
    SourceArgument,
    announced_config,
    refuse_given,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, claim_outputs, progress_bar, say, show
from sfr_loc_map.cli.verdict import not_judged
from sfr_loc_map.errors import ConfigError, FailedVerdictError, naming
from sfr_loc_map.metrics.conditions import Condition

CONDITIONS = ("distance=1", "distance=5")
MAX_ESTIMATES = 2  #: Maximum number of other estimates.


@app.command(
    epilog=examples(
        "sfr check drive.mcap",
        "sfr check data/ --condition distance=2 --json check.json",
        "sfr check drive.mcap --estimate wheels.csv --estimate other.csv",
    )
)
def check(
    context: Context,
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
    """Check whether runs over a drive, and maps of several pairs, agree as their covariances predict; without truth.

    The check detects errors or gives a lower bound of the error. It never proves an accuracy, because errors that all
    runs share, such as those of the calibration, stay hidden.
    """
    from sfr_loc_map.evidence.check_tables import check_tables
    from sfr_loc_map.evidence.recording import (
        calls_of_check,
        check_recording,
        has_drive_to_check,
        names_of_estimates,
        read_estimates,
    )
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.scoring.provenance import provenance_of_source

    source_config = announced_config(source, config, remap)
    claim_outputs(json_path, inputs=(source, source_config.configuration.path, *(estimate or ())), overwrite=overwrite)
    if len(estimate or ()) > MAX_ESTIMATES:
        raise ConfigError(
            f"'--estimate' is given {len(estimate or ())} times: at most {MAX_ESTIMATES} estimates can be compared "
            "with the run of the built-in localiser"
        )
    names = names_of_estimates(estimate or ())
    others = read_estimates(names)
    conditions = list(dict.fromkeys(Condition.parse(text) for text in condition or CONDITIONS))
    opened = open_source(source, source_config)
    if not has_drive_to_check(opened):
        of_drives = ("condition", "estimate", "pairs")
        refuse_given(context, of_drives, f"applies to a drive, but '{source}' has only mapping pairs: omit it")
    settings = {
        **source_config.changed_reading,
        "check.conditions": [item.setting for item in conditions],
        "check.pairs": pairs,
    }
    named = {name: path for path, name in names.items()}
    made = provenance_of_source(opened, named, command_line(), settings)
    with naming(source), progress_bar("pairs") as bar:
        task = bar.add_task("checking", total=calls_of_check(opened, pairs))
        found = check_recording(
            opened, source_config.configuration, conditions, pairs, others, lambda: bar.advance(task)
        )
    found = replace(found, provenance=made)
    show(found.to_dict(), json_path, check_tables(found.figures, found.advice))
    is_silent = json_path == STANDARD_OUTPUT
    for subject, count in found.pairs.items():
        covered = f"{count} of {found.pairs_of_source[subject]} pairs"
        checked = f"{found.checked[subject]} comparisons have enough data"
        say(
            f"{subject}: {found.results[subject]} ({covered}; {checked}). The result does not prove accuracy, "
            "because errors common to all runs are not observable",
            err=is_silent,
        )
    for text in found.calibration:
        say(f"calibration: {text}", err=is_silent)
    if found.disagreements:
        raise FailedVerdictError("; ".join(found.disagreements))
    if found.calibration:
        raise FailedVerdictError("the calibration does not fit the recording: each offset is named above")
    not_judged(found.not_checked, lenient=lenient)
