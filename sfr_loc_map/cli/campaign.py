"""`sfr campaign`: injected faults, rates and long runs of the nodes."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sfr_loc_map.cli.app import App, examples, help_without_command
from sfr_loc_map.cli.options import OverwriteOption, require_ros
from sfr_loc_map.cli.output import check_outputs, say, write_text
from sfr_loc_map.errors import FailedVerdictError, InterruptedRunError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfr_loc_map.fault_injection.fault import Fault
    from sfr_loc_map.fault_injection.report import Row
    from sfr_loc_map.fault_injection.settings import CampaignSettings

app = App(help="The node processes over real DDS: injected faults, rates, long runs.")
app.callback(invoke_without_command=True)(help_without_command)

JsonFileOption = Annotated[Path | None, typer.Option("--json", metavar="F", help="All figures as JSON.")]
MinutesOption = Annotated[float, typer.Option(min=0.05, max=10_000.0, metavar="MINUTES", help="How long.")]


@app.command(epilog=examples("sfr campaign faults --json faults.json --markdown faults.md"))
def faults(
    fault: Annotated[
        list[str] | None,
        typer.Option("--fault", metavar="ROW", help="Name of a row; repeatable. All by default."),
    ] = None,
    stop_s: Annotated[float, typer.Option(min=0.5, max=600.0, metavar="S", help="How long SIGSTOP lasts.")] = 10.0,
    restart_limit_s: Annotated[
        float,
        typer.Option(min=0.1, max=600.0, metavar="S", help="Longest restart of a killed node."),
    ] = 3.0,
    soak_minutes: Annotated[
        float, typer.Option(min=0.0, max=10_000.0, metavar="MINUTES", help="Length of the soak; 0: none.")
    ] = 1.0,
    json_path: JsonFileOption = None,
    markdown_path: Annotated[Path | None, typer.Option("--markdown", metavar="F.md", help="Table as Markdown.")] = None,
    keep: Annotated[
        Path | None,
        typer.Option("--keep", metavar="DIR", help="Folder for the nodes' logs; deleted by default."),
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Inject one fault after the other into the nodes; exit 1 if one of them has another outcome than expected."""
    require_ros("campaign")
    from sfr_loc_map.fault_injection.report import Verdict, outcome_table, report
    from sfr_loc_map.fault_injection.run import select
    from sfr_loc_map.fault_injection.settings import CampaignSettings
    from sfr_loc_map.report.tables import to_markdown

    settings = CampaignSettings(stop_s=stop_s, restart_limit_s=restart_limit_s, soak_minutes=soak_minutes)
    chosen = select(fault or [], settings)
    check_outputs(json_path, markdown_path, overwrite=overwrite)
    with tempfile.TemporaryDirectory(prefix="sfr_campaign.") as scratch:
        folder = keep or Path(scratch)
        rows, seconds = _run(chosen, settings, folder)
    _write_json(report(rows, settings, seconds), json_path)
    if markdown_path is not None:
        write_text(to_markdown([outcome_table(rows)]), markdown_path)
    failed = [row.name for row in rows if row.verdict is Verdict.FAIL]
    say(f"{len(rows)} rows in {seconds:.0f} s, {len(failed)} not as expected")
    if len(rows) < len(chosen):
        raise InterruptedRunError(f"interrupted: {len(rows)} of {len(chosen)} rows were finished, and reported")
    if failed:
        raise FailedVerdictError(f"not as expected: {', '.join(failed)}")


@app.command(epilog=examples("sfr campaign rate --minutes 1 --rate 10 --size 512 --json rate.json"))
def rate(
    minutes: MinutesOption = 10.0,
    rate_hz: Annotated[
        float,
        typer.Option("--rate", min=0.0, max=1000.0, metavar="HZ", help="Pairs per second; 0: lock step."),
    ] = 10.0,
    size: Annotated[int, typer.Option(min=64, max=4096, metavar="PX", help="Width and height of the images.")] = 1024,
    json_path: JsonFileOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Send stereo pairs through the localisation node: what is lost, what transport and conversion add."""
    require_ros("campaign")
    from sfr_loc_map.fault_injection.rate import RateSettings, carry_images

    check_outputs(json_path, overwrite=overwrite)
    with tempfile.TemporaryDirectory(prefix="sfr_campaign.") as scratch:
        result = carry_images(RateSettings(minutes, rate_hz, size), Path(scratch))
    say(f"{result['pairs_sent']} pairs sent, {result['pairs_localised']} localised, dropped {result['dropped']}")
    for name, times in result["times"].items():
        figures = ", ".join(f"{key} {1e3 * value:.1f}" for key, value in times.items())
        say(f"{name.removesuffix('_s'):20}{figures} ms")
    _conclude(result, json_path)


@app.command(epilog=examples("sfr campaign monitor --minutes 1 --rate 50 --json monitor.json"))
def monitor(
    minutes: MinutesOption = 10.0,
    rate_hz: Annotated[
        float, typer.Option("--rate", min=0.1, max=1000.0, metavar="HZ", help="Poses per second.")
    ] = 50.0,
    json_path: JsonFileOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Send estimates, truth and calls to the monitor: is each of them scored, is its memory flat."""
    require_ros("campaign")
    from sfr_loc_map.fault_injection.rate import RateSettings, carry_poses

    check_outputs(json_path, overwrite=overwrite)
    with tempfile.TemporaryDirectory(prefix="sfr_campaign.") as scratch:
        result = carry_poses(RateSettings(minutes, rate_hz), Path(scratch))
    say(f"{result['poses_sent']} poses sent at {result['rate_hz']:.1f} Hz, {result['poses_scored']} scored")
    say(f"processor {100 * result['processor_share']:.0f} % of one core")
    _conclude(result, json_path)


def _run(faults: Sequence[Fault], settings: CampaignSettings, folder: Path) -> tuple[list[Row], float]:
    """Inject faults; return their rows, of an interrupted campaign those that were finished, and the time taken, s."""
    from sfr_loc_map.fault_injection.run import run_campaign

    rows: list[Row] = []

    def done(row: Row) -> None:
        rows.append(row)
        _say(row)

    begin = time.monotonic()
    try:
        run_campaign(faults, settings, folder, done)
    except KeyboardInterrupt:
        if not rows:
            raise
    return rows, time.monotonic() - begin


def _conclude(result: dict[str, Any], json_path: Path | None) -> None:
    memory = result["memory"]
    slope = f"{memory['slope_mb_h']:+.1f} +- {2 * memory['error_mb_h']:.1f} MB/h"
    say(f"memory {memory['mb'][-1]:.0f} MB, {slope} after the warm-up")
    _write_json(result, json_path)
    if result["failures"]:
        raise FailedVerdictError("; ".join(result["failures"]))


def _say(row: Row) -> None:
    time = "" if row.recover_s is None else f", recovered in {row.recover_s:.1f} s"
    say(f"{row.verdict:8}{row.name}{time}: {row.observed}; lost: {row.lost or '-'}")


def _write_json(content: object, path: Path | None) -> None:
    if path is not None:
        write_text(json.dumps(content, indent=1), path)
