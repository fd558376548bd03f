"""`sfr compare`: which of several scores is better, and by how much."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from sfr_loc_map.cli.app import app
from sfr_loc_map.errors import ConfigError


@app.command()
def compare(
    scores: Annotated[
        list[Path],
        typer.Argument(metavar="A.json B.json ...", help="Scores of sfr score --json; the first is compared with."),
    ],
    json_path: Annotated[
        str | None, typer.Option("--json", metavar="F", help="Write the comparison as JSON; - for standard output.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page.")] = None,
) -> None:
    """Compare scores of the same data, paired by sub-trajectory."""
    from rich.console import Console

    from sfr_loc_map.metrics.comparison import compare_scores
    from sfr_loc_map.report.page import load_score

    result = compare_scores([load_score(path) for path in scores], _names(scores))
    text = json.dumps(result, allow_nan=False) + "\n"
    if json_path == "-":
        sys.stdout.write(text)
    elif json_path is not None:
        _write(Path(json_path), text)
    tables = comparison_tables(result)
    if html is not None:
        if html.suffix not in (".html", ".htm"):
            raise ConfigError(f"'--html {html}': the name of a page ends in .html")
        _write(html, _page(tables))
    if json_path != "-":
        console = Console()
        console = console if console.is_terminal else Console(width=120)
        for table in tables:
            console.print(table)


def _names(paths: list[Path]) -> list[str]:
    """Return the shortest names that tell the files apart."""
    for parts in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-parts:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    return [f"{number}: {path}" for number, path in enumerate(paths, 1)]


def _write(path: Path, text: str) -> None:
    from sfr_loc_map.io.atomic import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def comparison_tables(result: dict[str, Any]) -> list[Any]:
    """Return the comparison as rich tables."""
    from rich.box import SIMPLE_HEAD
    from rich.markup import escape
    from rich.table import Table

    names = [escape(name) for name in result["names"]]
    style = {"title_justify": "left", "header_style": "bold", "box": SIMPLE_HEAD, "pad_edge": False}
    tables = []
    if result["pairs"]:
        title = f"Mean + 3 sigma, compared with {names[0]}, paired by sub-trajectory"
        table = Table(title=title, **style)  # type: ignore[arg-type]
        for column in ("figure", "of", names[0], "other", "difference", "95 % interval", "n", "the other is"):
            table.add_column(column, no_wrap=column == "figure")
        for pair in result["pairs"]:
            table.add_row(*_pair_cells(pair))
        tables.append(table)
    if result["side_by_side"]:
        table = Table(title="Whole runs, side by side (not paired: no interval)", **style)  # type: ignore[arg-type]
        for column in ("figure", *names):
            table.add_column(column)
        for row in result["side_by_side"]:
            table.add_row(row["figure"], *(_number(value) for value in row["values"]))
        tables.append(table)
    return tables


def _pair_cells(pair: dict[str, Any]) -> list[str]:
    from rich.markup import escape

    condition = " ".join(f"{value:g} {key.split('_')[-1]}" for key, value in pair["condition"].items())
    name, _, unit = pair["figure"].partition("_")
    ci95 = pair["ci95"]
    interval = "-" if ci95 is None else f"{ci95[0]:+.4g} to {ci95[1]:+.4g}"
    difference = "-" if pair["difference"] is None else f"{pair['difference']:+.4g}"
    figures = (_number(pair["first"]), _number(pair["other"]), difference, interval, str(pair["count"]))
    return [f"{name}, {unit}, over {condition}", escape(pair["name"]), *figures, pair["verdict"]]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _page(tables: list[Any]) -> str:
    """Return a plain page of the tables, without script or network."""
    from html import escape

    parts = []
    for table in tables:
        columns = [[str(cell) for cell in column.cells] for column in table.columns]
        heads = "".join(f"<th>{escape(str(column.header))}</th>" for column in table.columns)
        rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in zip(*columns, strict=True))
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        parts.append(
            f"<h2>{escape(str(table.title))}</h2><table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"
        )
    style = (
        ":root{color-scheme:light dark}body{font:15px/1.5 system-ui,sans-serif;margin:2rem;max-width:75rem}"
        "table{border-collapse:collapse}th,td{padding:.3rem .8rem;text-align:left;border-bottom:1px solid #8886}"
    )
    head = f'<meta charset="utf-8"><title>Comparison of scores</title><style>{style}</style>'
    content = "<h1>Comparison of scores</h1>" + "".join(parts)
    return f'<!DOCTYPE html><html lang="en"><head>{head}</head><body>{content}</body></html>\n'
