"""What a suite writes beside its results: `suite.json`, `report.html`, and a table for pandas where it can."""

from __future__ import annotations

import json
from pathlib import Path

from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.report.page import render_overview, render_page
from sfr_loc_map.suite.figures import suite_figures
from sfr_loc_map.suite.parquet import write_parquet
from sfr_loc_map.suite.summary import Summary
from sfr_loc_map.suite.tables import PAGES, linked, suite_tables


def write_summary(summary: Summary, folder: Path) -> None:
    """Write `suite.json`, `report.html` and, where pyarrow is installed, `results.parquet`.

    Raises:
        OutputError: If a file cannot be written.
    """
    with atomic_path(folder / "suite.json") as temporary:
        temporary.write_text(json.dumps(summary.to_dict(), allow_nan=False) + "\n", encoding="utf-8")
    with atomic_path(folder / "report.html") as temporary:
        temporary.write_text(render(summary), encoding="utf-8")
    write_parquet(summary, folder / "results.parquet")
    pages = folder / PAGES
    pages.mkdir(exist_ok=True)
    for drive in linked(summary):
        with atomic_path(pages / f"{drive.key}.html") as temporary:
            temporary.write_text(render_page(drive.score, figures=False), encoding="utf-8")


def render(summary: Summary) -> str:
    """Return the page as HTML."""
    state = summary.verdict
    counts = f"{summary.done} of {summary.tasks} tasks done, {summary.failed} failed, {summary.waiting} waiting."
    return render_overview("Suite of runs", state, counts, suite_tables(summary, commands=True), suite_figures(summary))
