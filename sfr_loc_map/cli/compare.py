"""`sfr compare`: which of several scores is better, and by how much."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.output import (
    HTML_SUFFIXES,
    HtmlOption,
    JsonOption,
    OverwriteOption,
    check_outputs,
    check_suffix,
    show,
    write_text,
)

TITLE = "Comparison of scores"


@app.command(epilog=examples("sfr compare before.json after.json --html comparison.html"))
def compare(
    scores: Annotated[
        list[Path],
        typer.Argument(metavar="A.json B.json ...", help="Scores of sfr score --json; the first is the reference."),
    ],
    json_path: JsonOption = None,
    html: HtmlOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Compare scores of the same data, paired by sub-trajectory."""
    from sfr_loc_map.metrics.comparison import compare_scores
    from sfr_loc_map.report.comparison_tables import comparison_tables
    from sfr_loc_map.report.page import load_score, render_tables

    check_suffix(html, HTML_SUFFIXES)
    check_outputs(json_path, html, overwrite=overwrite, inputs=scores)
    result = compare_scores([load_score(path) for path in scores], _names(scores))
    tables = comparison_tables(result)
    if html is not None:
        write_text(render_tables(TITLE, tables), html)
    show(json.dumps(result.to_dict(), allow_nan=False) + "\n", json_path, tables)


def _names(paths: list[Path]) -> list[str]:
    """Return the shortest names that tell the files apart."""
    for parts in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-parts:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    return [f"{number}: {path}" for number, path in enumerate(paths, 1)]
