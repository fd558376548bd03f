"""`sfr report`: the page and the tables of a score."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app
from sfr_loc_map.errors import ConfigError

SUFFIXES = {".html": "html", ".htm": "html", ".md": "md", ".csv": "csv"}
FORMATS = ("html", "md", "csv", "pdf-ready")


@app.command()
def report(
    score: Annotated[
        Path, typer.Argument(metavar="SCORE.json", help="Score, as sfr score --json or sfr replay write.")
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File; report.html beside the score, or standard output.")
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="html|md|csv|pdf-ready",
            help="Page with figures, tables as Markdown or CSV, or a page of tables to print; by the ending.",
        ),
    ] = None,
) -> None:
    """Make the report page, or tables, of a score."""
    from sfr_loc_map.report.page import load_score, render_page
    from sfr_loc_map.report.tables import to_csv, to_markdown

    chosen = _form(form, output)
    content = load_score(score)
    makers = {
        "html": render_page,
        "pdf-ready": lambda value: render_page(value, figures=False),
        "md": to_markdown,
        "csv": to_csv,
    }
    text = makers[chosen](content)
    if output is None and chosen == "html":
        output = score.with_name("report.html")
    if output is None:
        sys.stdout.write(text)
    else:
        _write(text, output)


def _form(form: str | None, output: Path | None) -> str:
    """Return the format that was asked for, by name or by the ending of the file."""
    if form is not None:
        if form not in FORMATS:
            raise ConfigError(f"'--format {form}': must be one of {', '.join(FORMATS)}")
        return form
    if output is None:
        return "html"
    if output.suffix not in SUFFIXES:
        raise ConfigError(f"'-o {output}': the ending must be one of {', '.join(SUFFIXES)}, or give --format")
    return SUFFIXES[output.suffix]


def _write(text: str, output: Path) -> None:
    from sfr_loc_map.io.atomic import atomic_path

    with atomic_path(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    typer.echo(f"report: {output}")
