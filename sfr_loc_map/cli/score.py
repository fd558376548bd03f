"""`sfr score`: how good is a trajectory or a map, and does it meet the limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import app
from sfr_loc_map.cli.common import ConditionOption
from sfr_loc_map.cli.output import STANDARD_OUTPUT, JsonOption, check_json, check_output, show
from sfr_loc_map.errors import ConfigError, FailedVerdictError, MissingExtraError

if TYPE_CHECKING:
    from sfr_loc_map.metrics.config import ScoreConfig
    from sfr_loc_map.metrics.score import Score, Verdict

LimitsOption = Annotated[Path | None, typer.Option("--limits", help="Limits (YAML); exit code 1 if one is missed.")]
StatsOption = Annotated[
    list[Path] | None, typer.Option(help="CSV with the calls (time, memory, state, covariance); repeatable.")
]
TargetTimingOption = Annotated[
    Path | None, typer.Option(help="CSV with calls on the target: processing_time_s, state, peak_rss_bytes.")
]
RangeOption = Annotated[
    tuple[float, float], typer.Option("--range", help="Ranges of the truth that count for coverage, m.")
]
FusedOption = Annotated[
    bool | None,
    typer.Option("--fused/--not-fused", help="Whether the cloud is fused, for a file that does not say so."),
]


@app.command()
def score(
    estimate: Annotated[
        Path, typer.Argument(metavar="EST", help="Trajectory (TUM, csv, bag) or cloud (.ply, .pcd, .npz).")
    ],
    truth: Annotated[
        Path, typer.Argument(metavar="TRUTH", help="Trajectory, bag or data set; for a cloud a source with truth.")
    ],
    condition: ConditionOption = None,
    spacing: Annotated[int, typer.Option(help="Frames from one start to the next.")] = 10,
    rebase: Annotated[str, typer.Option(help="Taken from the estimate at a start: pose or position.")] = "pose",
    limits: LimitsOption = None,
    stats: StatsOption = None,
    target: Annotated[str | None, typer.Option(help="Name of the target that --target-timing was measured on.")] = None,
    target_timing: TargetTimingOption = None,
    associate: Annotated[str, typer.Option(help="Truth of an estimate: auto, match or interpolate.")] = "auto",
    max_gap: Annotated[float, typer.Option(help="Longest gap of the truth that is interpolated, s.")] = 1.0,
    scored_range: RangeOption = (0.0, 10.0),
    fused: FusedOption = None,
    json_path: JsonOption = None,
    html: Annotated[Path | None, typer.Option(help="Write a page with figures.")] = None,
) -> None:
    """Score an estimate against the truth."""
    from sfr_loc_map.metrics.verdicts.limits import load_limits
    from sfr_loc_map.pipeline.score_inputs import ScoreInputs
    from sfr_loc_map.pipeline.scoring import score_files

    parsed_limits = load_limits(limits) if limits is not None else None
    settings: dict[str, object] = {
        "trajectory.spacing": spacing,
        "trajectory.rebase": rebase,
        "trajectory.association.truth": associate,
        "trajectory.association.max_gap_s": max_gap,
        "map.scored_from_m": scored_range[0],
        "map.scored_to_m": scored_range[1],
    }
    config = score_config(condition, settings)
    if (target is None) != (target_timing is None):
        raise ConfigError("'--target' and '--target-timing' belong together: give the name and the file")
    inputs = replace(ScoreInputs.of(estimate, truth, stats or ()), target=target_timing, target_name=target or "")
    check_json(json_path)
    check_output(html, (".html", ".htm"))
    present(score_files(inputs, config, parsed_limits, fused=fused), json_path, html)


def score_config(conditions: list[str] | None, settings: dict[str, object]) -> ScoreConfig:
    """Return the settings of a score from options.

    Raises:
        ConfigError: If one is not valid.
    """
    from sfr_loc_map.config import build
    from sfr_loc_map.metrics.config import ScoreConfig

    named = {"trajectory.conditions": tuple(conditions)} if conditions else {}
    return build(ScoreConfig, settings | named, origin="options")


def present(score: Score, json_path: str | None, html: Path | None) -> None:
    """Write and print a score.

    Raises:
        ConfigError: If there is nothing in it.
        FailedVerdictError: If a limit was missed.
    """
    from sfr_loc_map.metrics.score_json import to_json
    from sfr_loc_map.report.score_tables import summary_tables

    tables = summary_tables(score)
    if not tables and json_path != STANDARD_OUTPUT:
        raise ConfigError("nothing was scored: give an estimate and its truth")
    show(to_json(score), json_path, tables)
    if html is not None:
        _write_page(score, html)
    for warning in score.warnings:
        typer.echo(f"sfr: warning: {warning}", err=True)
    if score.failed:
        missed = ", ".join(map(_missed, score.failed))
        raise FailedVerdictError(f"{len(score.failed)} of {len(score.verdicts)} limits missed: {missed}")


def _missed(item: Verdict) -> str:
    """Return a limit that was missed, in the words of the limits file."""
    name = item.metric.removesuffix("_min")
    return f"{name} {item.value:.6g} {'>' if name == item.metric else 'against'} {item.limit:g}"


def _write_page(score: Score, html: Path) -> None:
    from importlib import import_module

    try:
        page = import_module("sfr_loc_map.report.page")
    except ImportError as error:
        raise MissingExtraError(f"the report page is not available ({error}): leave out --html") from error
    page.write_page(score, html)
