"""`sfr init`: a configuration and limits to begin with; `sfr methods`: what `--method` knows by name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import JsonOption, OverwriteOption
from sfr_loc_map.cli.output import check_outputs, make_folder, say, show, write_text


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
    make_folder(folder, "name")
    check_outputs(configuration, limits, overwrite=overwrite)
    write_text(configuration_text(), configuration)
    write_text(limits_text(), limits)
    say(f"configuration: {configuration}")
    say(f"limits: {limits}")
    words = ("sfr", "replay", "SRC", "--start", "truth", "--config", configuration, "--limits", limits, "--out", "out/")
    propose(*words, why="SRC: a bag or folder of yours; sfr doctor SRC says what it lacks")


@app.command(
    epilog=examples("sfr methods", "sfr methods --include-dir", "sfr methods --peer-python peers/bin/python"),
    hint="sfr localise SRC -o T.csv --method NAME    # the same drive by another method",
)
def methods(
    peer_python: Annotated[
        Path | None, typer.Option("--peer-python", metavar="PYTHON", help="Interpreter in which peers are looked for.")
    ] = None,
    include_dir: Annotated[
        bool, typer.Option("--include-dir", help="Print the folder of sfr_candidate.h, and nothing else.")
    ] = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """List the methods under test with their versions; a class or a C library needs no entry here."""
    from sfr_loc_map.methods.header import header_folder
    from sfr_loc_map.methods.registry import listed_methods
    from sfr_loc_map.metrics.score_json import json_line
    from sfr_loc_map.report.tables import Cell, Column, Table

    if include_dir:
        say(str(header_folder()))
        return
    check_outputs(json_path, overwrite=overwrite)
    found = list(listed_methods(peer_python))
    rows = tuple(
        (Cell.head(item.task), Cell(item.name), Cell(item.version or "-"), Cell(item.kind), Cell(item.about))
        for item in found
    )
    columns = tuple(Column(title, words=True) for title in ("task", "method", "version", "kind", ""))
    show(json_line({"methods": found}), json_path, [Table("methods", "Methods", columns, rows)])
