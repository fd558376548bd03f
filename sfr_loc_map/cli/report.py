"""`sfr report`: the page and the tables of a score."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import OverwriteOption, check_outputs, say, write_text
from sfr_loc_map.errors import ConfigError

if TYPE_CHECKING:
    from sfr_loc_map.metrics.score import Score


class Format(StrEnum):
    """What the report is written as."""

    HTML = "html"
    MARKDOWN = "md"
    CSV = "csv"
    PDF_READY = "pdf-ready"


SUFFIXES = {".html": Format.HTML, ".htm": Format.HTML, ".md": Format.MARKDOWN, ".csv": Format.CSV}


@app.command(
    epilog=examples(
        "sfr report out/report.json -o page.html",
        "sfr report out/report.json -o tables.md",
        "sfr report out/report.json --format pdf-ready -o print.html",
    )
)
def report(
    score: Annotated[
        Path, typer.Argument(metavar="SCORE.json", help="Score, as sfr score --json or sfr replay write.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="F", help="File; by default report.html beside the score, or standard output."
        ),
    ] = None,
    form: Annotated[
        Format | None,
        typer.Option(
            "--format",
            help="Page with figures, tables as Markdown or CSV, or a page of tables to print; by the ending.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Make the report page, or tables, of a score."""
    from sfr_loc_map.report.page import load_score

    chosen = form or _format_of(output)
    if output is None and chosen is Format.HTML:
        output = score.with_name("report.html")
    loaded = load_score(score)
    check_outputs(output, overwrite=overwrite, inputs=(score,))
    text = _text(loaded, chosen)
    if output is None:
        sys.stdout.write(text)
        return
    write_text(text, output)
    say(f"report: {output}")
    if chosen in (Format.HTML, Format.PDF_READY):
        propose(f"open {output} in a browser")


def _text(score: Score, form: Format) -> str:
    from sfr_loc_map.report.page import render_page
    from sfr_loc_map.report.score_tables import score_markdown, score_tables
    from sfr_loc_map.tables.csv_rows import to_csv

    if form is Format.MARKDOWN:
        return score_markdown(score)
    if form is Format.CSV:
        return to_csv(score_tables(score))
    return render_page(score, figures=form is Format.HTML)


def _format_of(output: Path | None) -> Format:
    """Return the format by the ending of the file."""
    if output is None:
        return Format.HTML
    if output.suffix not in SUFFIXES:
        raise ConfigError(f"'-o {output}': the ending must be one of {', '.join(SUFFIXES)}, or give --format")
    return SUFFIXES[output.suffix]
