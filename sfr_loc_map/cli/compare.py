"""`sfr compare`: which of several scores is better, and by how much."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.next_step import propose
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

if TYPE_CHECKING:
    from sfr_loc_map.metrics.score import Score

TITLE = "Comparison of scores"
PROVENANCE = "provenance"
"""A table that is too wide for a terminal; the page has it."""


@app.command(
    epilog=examples(
        "sfr compare before.json after.json --html comparison.html",
        "sfr compare ours.json opencv.json node/report.json --html methods.html",
    )
)
def compare(
    scores: Annotated[
        list[Path],
        typer.Argument(metavar="A.json B.json ...", help="Scores of sfr score --json; the first is the reference."),
    ],
    json_path: JsonOption = None,
    html: HtmlOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Compare scores of the same data, of one method or of several, paired by sub-trajectory."""
    from sfr_loc_map.metrics.comparison import compare_scores
    from sfr_loc_map.report.comparison_tables import comparison_tables
    from sfr_loc_map.report.methods_figures import methods_figures
    from sfr_loc_map.report.methods_tables import methods_tables
    from sfr_loc_map.report.page import load_score, render_overview

    check_suffix(html, HTML_SUFFIXES)
    check_outputs(json_path, html, overwrite=overwrite, inputs=scores)
    loaded = [load_score(path) for path in scores]
    names = _names(scores, loaded)
    result = compare_scores(loaded, names)
    tables = [*methods_tables(loaded, names), *comparison_tables(result)]
    if html is not None:
        text = f"{len(names)} scores of the same data; the reference is {names[0]}."
        write_text(render_overview(TITLE, None, text, tables, methods_figures(loaded, names)), html)
    shown = [table for table in tables if table.name != PROVENANCE]
    if html is not None:
        propose(f"open {html} in a browser")
    show(json.dumps(result.to_dict(), allow_nan=False) + "\n", json_path, shown)


def _names(paths: list[Path], scores: list[Score]) -> list[str]:
    """Return the methods' names where they tell the scores apart, otherwise the shortest names of the files."""
    methods = [score.method.name.rpartition("/")[2] for score in scores if score.method is not None]
    if len(set(methods)) == len(paths):
        return methods
    return _file_names(paths)


def _file_names(paths: list[Path]) -> list[str]:
    """Return the shortest names that tell the files apart."""
    for parts in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-parts:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    return [f"{number}: {path}" for number, path in enumerate(paths, 1)]
