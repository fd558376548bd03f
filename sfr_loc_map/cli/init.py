"""`sfr init`: write an initial configuration and initial limits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Argument, Context, Option

from sfr_loc_map.atomic import write_text
from sfr_loc_map.cli.app import app, examples, propose, propose_again
from sfr_loc_map.cli.options import (
    CalibrationOption,
    OverwriteOption,
    RemapOption,
    SectionsOption,
    configuration_of,
    refuse_given,
)
from sfr_loc_map.cli.output import claim_outputs, make_folder, say
from sfr_loc_map.configuration.sections import Configuration, Key
from sfr_loc_map.errors import FailedVerdictError, OutputError
from sfr_loc_map.suffixes import check_is_folder_name

LIMITS = "limits.yaml"  #: Name of the limits file.
PLACEHOLDERS = "placeholders: replace them by your limits"
KEPT = "the existing file is kept"


@app.command(epilog=examples("sfr init my_rover/", "sfr init my_rover/ --from drive.mcap --calibration camchain.yaml"))
def init(
    context: Context,
    directory: Annotated[
        str, Argument(metavar="DIR", help="Folder for the files; created if it does not exist.", show_default=True)
    ] = ".",
    source: Annotated[
        Path | None, Option("--from", metavar="SRC", help="Recording for which DIR/sfr.yaml is written.")
    ] = None,
    calibration: CalibrationOption = None,
    settings: SectionsOption = None,
    remap: RemapOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write an initial configuration with comments and limits: DIR/configuration.yaml and DIR/limits.yaml.

    Each parameter is listed with its description, unit, range and default. sfr replay, localise and map
    accept the configuration unchanged (--config). sfr score and replay accept the limits (--limits).

    With --from the configuration is DIR/sfr.yaml. It states how SRC is read, and what each value was inferred from.
    Exit 1 if values are missing that only you know.
    """
    folder = _folder(directory)
    if source is not None:
        given = configuration_of(source, None, calibration, settings, remap)
        _init_from(source, folder, given, (source, calibration), overwrite=overwrite)
        return
    of_recording = ("calibration", "settings", "remap")
    refuse_given(context, of_recording, "describes a recording: give --from SRC, too")
    from sfr_loc_map.metrics.judging.limits_template import limits_text
    from sfr_loc_map.source_setup.initial_files import configuration_text, is_kept

    make_folder(folder, "name")
    configuration, limits = folder / "configuration.yaml", folder / LIMITS
    has_limits = is_kept(limits)
    claim_outputs(configuration, *([] if has_limits else [limits]), overwrite=overwrite)
    write_text(configuration_text(), configuration)
    say(f"configuration: {configuration}")
    if not has_limits:
        write_text(limits_text(), limits)
    say(f"limits: {limits} ({KEPT if has_limits else PLACEHOLDERS})")
    words = ("sfr", "replay", "SRC", "--start", "truth", "--config", configuration, "--limits", limits, "--out", "out/")
    propose(*words, why="SRC: your bag or folder; sfr info SRC reports what is missing")


def _folder(name: str) -> Path:
    """Return the folder of the files; OutputError if its name is empty or that of a file."""
    if not name:
        raise OutputError("DIR is empty: give the name of a folder, or omit DIR for the working directory")
    path = Path(name)
    if not path.is_dir():
        check_is_folder_name(path, "an existing folder")
    return path


def _init_from(
    source: Path, folder: Path, given: Configuration, inputs: Iterable[Path | None], *, overwrite: bool
) -> None:
    """Write the configuration that is inferred from a source, and limits; report what is missing."""
    from sfr_loc_map.io.source_config import NAME
    from sfr_loc_map.source_setup.examination import propose_config
    from sfr_loc_map.source_setup.initial_files import initial_limits, is_kept
    from sfr_loc_map.source_setup.proposal import Value

    path, limits = folder / NAME, folder / LIMITS
    names_limits = "limits" in given.sections
    has_limits = names_limits or is_kept(limits)
    if folder.is_dir():
        claim_outputs(path, inputs=inputs, overwrite=overwrite)
        claim_outputs(None if has_limits else limits, inputs=inputs, overwrite=True)  # placeholders are replaced
    found = propose_config(source, replace(given, path=path))
    make_folder(folder, "name")
    if not has_limits:
        write_text(initial_limits(found), limits)
    if not names_limits:
        reason = KEPT if has_limits else PLACEHOLDERS
        found = found.adding(Value(Key("limits"), limits.name, reason))
        say(f"limits: {limits} ({reason})")
    write_text(found.text(), path)
    say(f"configuration: {path}")
    for text in found.remarks:
        say(f"remark: {text}", err=True)
    if found.missing:
        propose_again(*([] if overwrite else ["--overwrite"]), why="with the missing values")
        raise FailedVerdictError(f"'{path}' is not complete: {'; '.join(found.missing)}")
    start = ("--start", "truth") if found.truth is not None and found.truth.has_attitude else ()
    words = ("sfr", "replay", source, "--config", path, *start, "--out", "out")
    propose(*words, why="plays it to the nodes and scores the results")
