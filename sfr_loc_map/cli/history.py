"""`sfr history`: suites over commits or dates, and the first that is certainly worse."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.options import HtmlOption, JsonOption, OverwriteOption
from sfr_loc_map.cli.output import HTML_SUFFIXES, check_outputs, check_suffix, show, write_text
from sfr_loc_map.cli.suite import open_store
from sfr_loc_map.errors import FailedVerdictError


@app.command(epilog=examples("sfr history runs/2026-01 runs/2026-02 runs/2026-03 --html history.html"))
def history(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR", help="Folders of suites, in the order of time.")],
    json_path: JsonOption = None,
    html: HtmlOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Find the first suite that is certainly worse than what was before; exit code 1 if there is one."""
    from sfr_loc_map.suite.comparison_tables import history_tables
    from sfr_loc_map.suite.history import find_changes
    from sfr_loc_map.suite.history_page import render_history
    from sfr_loc_map.suite.history_runs import history_run

    check_suffix(html, HTML_SUFFIXES)
    check_outputs(json_path, html, overwrite=overwrite)
    result = find_changes([history_run(open_store(folder), str(folder)) for folder in folders])
    if html is not None:
        write_text(render_history(result), html)
    show(json.dumps(result.to_dict(), allow_nan=False) + "\n", json_path, history_tables(result))
    if result.first_worse:
        found = "; ".join(f"{kind}: {run}" for kind, run in result.first_worse.items())
        raise FailedVerdictError(f"certainly worse than before: {found}")
