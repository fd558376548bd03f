"""`sfr init`: a configuration and limits to begin with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import OverwriteOption, check_outputs, say, write_text
from sfr_loc_map.errors import OutputError


@app.command(epilog=examples("sfr init", "sfr init my_rover/", "sfr init my_rover/ --overwrite"))
def init(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder for the files; made if it is not there.")
    ] = Path("."),
    overwrite: OverwriteOption = False,
) -> None:
    """Write a commented configuration and limits to begin with: DIR/configuration.yaml and DIR/limits.yaml.

    Each parameter stands there with its description, unit, range and default. sfr replay, localise and map take the
    configuration as it is (--config), sfr score and replay the limits (--limits).
    """
    from sfr_loc_map.pipeline.starter_files import configuration_text, limits_text

    configuration, limits = folder / "configuration.yaml", folder / "limits.yaml"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder '{folder}': {error.strerror}; choose another name") from error
    check_outputs(configuration, limits, overwrite=overwrite)
    write_text(configuration_text(), configuration)
    write_text(limits_text(), limits)
    say(f"configuration: {configuration}")
    say(f"limits: {limits}")
    words = ("sfr", "replay", "SRC", "--start", "truth", "--config", configuration, "--limits", limits, "--out", "out/")
    propose(*words, why="SRC: a bag or folder of yours; sfr doctor SRC says what it lacks")
