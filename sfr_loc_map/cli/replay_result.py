"""What came out of a replay: checked, put together, told."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from sfr_loc_map.cli.external import external_run_of
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import say, warn
from sfr_loc_map.errors import NodeError

if TYPE_CHECKING:
    from sfr_loc_map.nodes.replay.options import ReplayOptions
    from sfr_loc_map.nodes.replay.results import ReplayResults
    from sfr_loc_map.pipeline.replay import ReplayFiles, ReplayResult
    from sfr_loc_map.pipeline.scoring import Correction


def check_answers(results: ReplayResults, options: ReplayOptions) -> None:
    """Say which answers of our nodes are missing; those of an external node are counted in the score.

    Raises:
        NodeError: If there is no cloud.
    """
    foreign = None if options.external is None else options.external.task
    played = len(results.published_stamps("loc"))
    missing = played - len(results.rows)
    if missing > 0 and foreign != "localisation":
        say(f"{missing} of {played} pairs have no odometry: the nodes could not keep up", err=True)
    if results.published_stamps("nav") and not results.clouds and foreign != "mapping":
        raise NodeError("mapping_node gave no cloud: play slower (--rate) or in lock step (--rate 0)")


def result_of(results: ReplayResults, correction: Correction) -> ReplayResult:
    """Return what the nodes published as files and score have it."""
    from sfr_loc_map.pipeline.replay import ReplayResult

    run = external_run_of(results, correction)
    (cloud, mapped_ns), points = results.last_map(), None
    if run is not None and run.score.task == "mapping":
        cloud, points, mapped_ns = results.external_map()
    cut_short = tuple(result_of(item, correction) for item in results.cut_short)
    return ReplayResult(results.trajectory, cloud, results.records, results.report, mapped_ns, cut_short, run, points)


def say_where(source: Path, result: ReplayResult, files: ReplayFiles, out: Path | None) -> None:
    """Say how it went and where it was written."""
    from sfr_loc_map.pipeline.tracking_summary import states_text, tracking_warning

    say(f"{len(result.estimate)} poses, {states_text(result.records)}", err=True)
    localised = [record for record in result.records if record.covariance is not None]
    text = tracking_warning(localised, source)
    if text is not None:
        warn(text)
    for number, run in enumerate(result.cut_short, 1):
        place = "--out DIR would keep it" if out is None else str(files.of_run(number).folder)
        typer.echo(f"a run of {len(run.estimate)} poses was cut short and is not scored: {place}", err=True)
    if out is not None:
        page = files.page if files.page.exists() else files.report
        say(f"report: {page}")
        propose(f"open {page} in a browser")
