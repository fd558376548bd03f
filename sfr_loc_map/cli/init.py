"""`sfr init`: write an initial configuration and initial limits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Argument, Context, Option

from sfr_loc_map.atomic import write_text
from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import (
    CalibrationOption,
    OverwriteOption,
    RemapOption,
    SectionsOption,
    configuration_of,
    refuse_given,
)
from sfr_loc_map.cli.output import check_outputs, make_folder, say
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import FailedVerdictError


@app.command(epilog=examples("sfr init my_rover/", "sfr init my_rover/ --from drive.mcap --calibration camchain.yaml"))
def init(
    context: Context,
    folder: Annotated[Path, Argument(metavar="DIR", help="Folder for the files; created if it does not exist.")] = Path(
        "."
    ),
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
    if source is not None:
        given = configuration_of(source, None, calibration, settings, remap)
        _init_from(source, folder, given, (source, calibration), overwrite=overwrite)
        return
    of_recording = ("calibration", "settings", "remap")
    refuse_given(context, of_recording, "describes a recording: give --from SRC, too")
    from sfr_loc_map.metrics.judging.limits_template import limits_text
    from sfr_loc_map.source_setup.initial_files import configuration_text

    make_folder(folder, "name")
    configuration, limits = folder / "configuration.yaml", folder / "limits.yaml"
    check_outputs(configuration, limits, overwrite=overwrite)
    write_text(configuration_text(), configuration)
    write_text(limits_text(), limits)
    say(f"configuration: {configuration}")
    say(f"limits: {limits}")
    words = ("sfr", "replay", "SRC", "--start", "truth", "--config", configuration, "--limits", limits, "--out", "out/")
    propose(*words, why="SRC: your bag or folder; sfr info SRC reports what is missing")


def _init_from(
    source: Path, folder: Path, given: Configuration, inputs: Iterable[Path | None], *, overwrite: bool
) -> None:
    """Write the configuration that is inferred from a source, and limits; report what is missing."""
    from sfr_loc_map.io.source_settings import NAME
    from sfr_loc_map.source_setup.initial_files import initial_limits
    from sfr_loc_map.source_setup.proposal import Findings, propose_config

    path, limits = folder / NAME, folder / "limits.yaml"
    if folder.is_dir():
        check_outputs(path, inputs=inputs, overwrite=overwrite)
    found = propose_config(source, replace(given, path=path))
    make_folder(folder, "name")
    if "limits" not in found.sections:
        value, text_of_limits = initial_limits(found, limits)
        if text_of_limits is not None:
            write_text(text_of_limits, limits)
        found = found.adding(Findings((value,)))
        say(f"limits: {limits} ({value.reason})")
    write_text(found.text(), path)
    say(f"configuration: {path}")
    for text in found.remarks:
        say(f"remark: {text}", err=True)
    if found.missing:
        propose("..." if overwrite else "... --overwrite", why="with the missing values")
        raise FailedVerdictError(f"'{path}' is not complete: {'; '.join(found.missing)}")
    start = ("--start", "truth") if found.truth is not None and found.truth.has_attitude else ()
    words = ("sfr", "replay", source, "--config", path, *start, "--out", "out")
    propose(*words, why="plays it to the nodes and scores the results")
