"""What the subcommands of `sfr bench` share: their group, what they print and write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sfr_loc_map.cli.app import App, help_without_command
from sfr_loc_map.cli.output import STANDARD_OUTPUT, say, show, write_text

app = App(help="Benchmarks beside other tools: same input, same run, own processes.")
app.callback(invoke_without_command=True)(help_without_command)


def present(result: dict[str, Any], json_path: str | None, markdown_path: Path | None = None) -> None:
    """Print tables, reference methods left out and failures; write JSON and Markdown; `--json -` prints JSON alone."""
    from sfr_loc_map.bench.tables import benchmark_tables
    from sfr_loc_map.metrics.score_json import json_line
    from sfr_loc_map.report.tables import to_markdown

    tables = benchmark_tables(result)
    if markdown_path is not None:
        write_text(to_markdown(tables), markdown_path)
    show(json_line(result), json_path, tables)
    if json_path == STANDARD_OUTPUT:
        return
    for name, reason in result["missing"].items():
        say(f"left out: {name}: {reason}")
    for part in (result, *result.get("sizes", ())):
        for name, reason in part.get("failed", {}).items():
            say(f"failed: {name}: {reason}")
        for name, texts in part.get("findings", {}).items():
            more = f" (and {len(texts) - 1} more)" if len(texts) > 1 else ""
            say(f"found: {name}: {texts[0]}{more}")
