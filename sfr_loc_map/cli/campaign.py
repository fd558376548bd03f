"""`sfr campaign`: what the nodes survive, and what they carry."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.common import check_output
from sfr_loc_map.errors import FailedVerdictError

app = typer.Typer(help="The node processes over real DDS: faults done on purpose, rates, long runs.")

JsonOption = Annotated[Path | None, typer.Option("--json", help="All figures as JSON.")]


@app.callback(invoke_without_command=True)
def _root(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
def faults(
    fault: Annotated[
        list[str] | None, typer.Option("--fault", help="Name of a row; repeatable. All by default.")
    ] = None,
    stop_s: Annotated[float, typer.Option(min=0.5, max=600.0, help="How long SIGSTOP lasts, seconds.")] = 10.0,
    restart_limit_s: Annotated[
        float, typer.Option(min=0.1, max=600.0, help="Longest from the start of a killed node to its first result.")
    ] = 3.0,
    soak_minutes: Annotated[float, typer.Option(min=0.0, max=10_000.0, help="Length of the soak; 0: none.")] = 1.0,
    json_path: JsonOption = None,
    markdown_path: Annotated[Path | None, typer.Option("--markdown", help="The table as Markdown.")] = None,
    keep: Annotated[
        Path | None, typer.Option("--keep", help="Folder for the nodes' logs; else they are thrown away.")
    ] = None,
) -> None:
    """Do one fault after the other to the nodes; exit 1 if one of them has not the outcome expected."""
    from sfr_loc_map.nodes.campaign.outcome import FAIL, CampaignSettings, markdown, report
    from sfr_loc_map.nodes.campaign.run import run_campaign, select, timed

    settings = CampaignSettings(stop_s=stop_s, restart_limit_s=restart_limit_s, soak_minutes=soak_minutes)
    chosen = select(fault or [], settings)
    for path in (json_path, markdown_path):
        check_output(path)
    with tempfile.TemporaryDirectory(prefix="sfr_campaign.") as scratch:
        folder = keep or Path(scratch)
        rows, seconds = timed(lambda: run_campaign(chosen, settings, folder, _say))
    _write(json_path, markdown_path, report(rows, settings, seconds), markdown(rows))
    failed = [row.name for row in rows if row.verdict == FAIL]
    typer.echo(f"{len(rows)} rows in {seconds:.0f} s, {len(failed)} not as expected")
    if failed:
        raise FailedVerdictError(f"not as expected: {', '.join(failed)}")


def _say(row: object) -> None:
    seconds = getattr(row, "recover_s", None)
    time = "" if seconds is None else f", recovered in {seconds:.1f} s"
    typer.echo(f"{row.verdict:8}{row.name}{time}: {row.observed}; lost: {row.lost or '-'}")  # type: ignore[attr-defined]


def _write(json_path: Path | None, markdown_path: Path | None, content: object, table: str) -> None:
    import json

    from sfr_loc_map.io.atomic import atomic_path

    for path, text in ((json_path, json.dumps(content, indent=1)), (markdown_path, table)):
        if path is not None:
            with atomic_path(path) as temporary:
                temporary.write_text(text, encoding="utf-8")
