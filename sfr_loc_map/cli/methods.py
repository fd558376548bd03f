"""`sfr methods`: the localisers and mappers that `--method` knows by name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.output import JsonOption, OverwriteOption, check_outputs, say, show


@app.command(epilog=examples("sfr methods", "sfr methods --include-dir", "sfr methods --peer-python peers/bin/python"))
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
    from sfr_loc_map.tables.table import Cell, Column, Table

    if include_dir:
        say(str(header_folder()))
        return
    check_outputs(json_path, overwrite=overwrite)
    found = list(listed_methods(peer_python))
    titles = ("task", "method", "version", "kind", "")
    rows = tuple(
        (Cell.head(item.task), Cell(item.name), Cell(item.version or "-"), Cell(item.kind), Cell(item.about))
        for item in found
    )
    table = Table("methods", "Methods", tuple(Column(title, words=True) for title in titles), rows)
    show(json_line({"methods": found}), json_path, [table])
