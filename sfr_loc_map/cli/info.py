"""`sfr info`: the content of a recording and the issues that block its use, each with its fix."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from typer import Context, Option

from sfr_loc_map.atomic import write_text
from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.issues import IssueList
from sfr_loc_map.cli.options import (
    CalibrationOption,
    ConfigOption,
    JsonOption,
    OverwriteOption,
    RemapOption,
    SectionsOption,
    SourceArgument,
    configuration_of,
    given_words,
)
from sfr_loc_map.cli.output import claim_outputs, progress_bar, say
from sfr_loc_map.configuration.sections import Configuration, is_ros_parameter_file
from sfr_loc_map.errors import ConfigError, InputError

if TYPE_CHECKING:
    from pathlib import Path

    from sfr_loc_map.io.source_config import SourceConfig


@app.command(
    epilog=examples(
        "sfr info drive.mcap",
        "sfr info recording.mcap --remap /cam0/image:=loc/left/image_rect",
        "sfr info recording.mcap --write",
        "sfr info data/ --json -",
    )
)
def info(
    context: Context,
    source: SourceArgument,
    write: Annotated[
        bool,
        Option(
            "--write",
            help="Write the inferred configuration into the sfr.yaml of the source, then examine the source again.",
        ),
    ] = False,
    config: ConfigOption = None,
    calibration: CalibrationOption = None,
    settings: SectionsOption = None,
    remap: RemapOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Show the content of a source and the issues that block its use, each with its fix; exit 1 if there are any."""
    from sfr_loc_map.doctor.examination import examine
    from sfr_loc_map.doctor.fixes import with_fix
    from sfr_loc_map.doctor.observation import observe
    from sfr_loc_map.io.registry import check_source_exists, open_source
    from sfr_loc_map.io.source_config import SourceConfig, config_beside
    from sfr_loc_map.io.source_format import is_bag
    from sfr_loc_map.scoring.provenance import data_set_of
    from sfr_loc_map.source_setup.facts import facts_of, facts_tables

    path = config or config_beside(source)
    claim_outputs(json_path, inputs=(source, path, calibration), overwrite=overwrite)
    can_write = path is None or not is_ros_parameter_file(path)
    if write and not can_write:
        raise ConfigError(
            f"'{path}' is a ROS parameter file, and --write would remove its other parameters: write an sfr.yaml by "
            f"sfr init DIR --from {source}"
        )
    given = configuration_of(source, path, calibration, settings, remap)
    source_config = SourceConfig.of(given)
    check_source_exists(source)
    if write:
        path, source_config = _write(source, given)
    with progress_bar("pairs") as bar:
        task = bar.add_task("reading", total=None)
        seen = observe(source, source_config, lambda: bar.advance(task))
    issues = examine(seen)
    if can_write and not write and any(issue.is_blocking for issue in issues):
        options = given_words(context, "config", "calibration", "settings", "remap")
        words = ["sfr", "info", str(source), "--write", *options]
        issues = with_fix(source, given, issues, words)
    found = IssueList(seen.subject, issues)
    facts = facts_of(source, source_config)
    is_unreadable = is_bag(source) and not facts.topics  # no topic could be read
    if facts.problem and (is_unreadable or not found.blocking):
        raise InputError(facts.problem)
    shown = {"configuration": None if path is None else str(path)} | facts.json_values
    if not facts.problem:
        inputs = data_set_of(open_source(source, source_config))
        shown |= {f"{role}_sha256": file.data_set_sha256 for role, file in inputs.items()}
    start = ["--start", "truth"] if seen.truth_has_attitude else []
    after = ["sfr", "replay", str(source), *given_words(context, "config"), *start, "--out", "out"]
    found.propose(after, why="plays it to the nodes and scores the results")
    found.show(json_path, shown, facts_tables(shown))


def _write(source: Path, given: Configuration) -> tuple[Path, SourceConfig]:
    """Write the proposed configuration to the file that was read, or to a new file; return the file and its content."""
    from sfr_loc_map.io.source_config import NAME
    from sfr_loc_map.source_setup.examination import propose_config

    place = given.path or (source if source.is_dir() else source.parent) / NAME
    found = propose_config(source, replace(given, path=place), Configuration.read(given.path))
    write_text(found.text(), place)
    kept = "" if given.path is None else ", updated: its values are kept"
    say(f"configuration: {place}{kept}", err=True)
    for text in found.missing:
        say(f"missing: {text}", err=True)
    for text in found.remarks:
        say(f"remark: {text}", err=True)
    return place, found.config
