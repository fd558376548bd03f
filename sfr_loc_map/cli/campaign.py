"""`sfr campaign`: what the nodes survive, and what they carry."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated, Any

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
    from sfr_loc_map.fault_injection.outcome import FAIL, CampaignSettings, markdown, report
    from sfr_loc_map.fault_injection.run import run_campaign, select, timed

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


@app.command()
def rate(
    minutes: Annotated[float, typer.Option(min=0.05, max=10_000.0, help="How long.")] = 10.0,
    rate_hz: Annotated[
        float, typer.Option("--rate", min=0.0, max=1000.0, help="Pairs a second; 0: lock step, one after the other.")
    ] = 10.0,
    size: Annotated[int, typer.Option(min=64, max=4096, help="Width and height of the pictures.")] = 1024,
    json_path: JsonOption = None,
) -> None:
    """Send stereo pairs through the localisation node: what is lost, what transport and conversion add."""
    from sfr_loc_map.fault_injection.rate import RateSettings, carry_images

    check_output(json_path)
    with tempfile.TemporaryDirectory(prefix="sfr_campaign.") as scratch:
        result = carry_images(RateSettings(minutes, rate_hz, size), Path(scratch))
    typer.echo(f"{result['pairs_sent']} pairs sent, {result['pairs_localised']} localised, dropped {result['dropped']}")
    for name, times in result["times"].items():
        figures = ", ".join(f"{key} {1e3 * value:.1f}" for key, value in times.items())
        typer.echo(f"{name.removesuffix('_s'):20}{figures} ms")
    _conclude(result, json_path)


@app.command()
def monitor(
    minutes: Annotated[float, typer.Option(min=0.05, max=10_000.0, help="How long.")] = 10.0,
    rate_hz: Annotated[float, typer.Option("--rate", min=0.1, max=1000.0, help="Poses a second.")] = 50.0,
    json_path: JsonOption = None,
) -> None:
    """Send estimates, truth and calls to the monitor: is each of them scored, is its memory flat."""
    from sfr_loc_map.fault_injection.rate import RateSettings, carry_poses

    check_output(json_path)
    with tempfile.TemporaryDirectory(prefix="sfr_campaign.") as scratch:
        result = carry_poses(RateSettings(minutes, rate_hz), Path(scratch))
    typer.echo(f"{result['poses_sent']} poses sent at {result['rate_hz']:.1f} Hz, {result['poses_scored']} scored")
    typer.echo(f"processor {100 * result['processor_share']:.0f} % of one core")
    _conclude(result, json_path)


def _conclude(result: dict[str, Any], json_path: Path | None) -> None:
    memory = result["memory"]
    slope = f"{memory['slope_mb_h']:+.1f} +- {2 * memory['error_mb_h']:.1f} MB/h"
    typer.echo(f"memory {memory['mb'][-1]:.0f} MB, {slope} after the warm-up")
    _write(json_path, None, result, "")
    if result["failures"]:
        raise FailedVerdictError("; ".join(result["failures"]))


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
