"""`sfr score`: how good is a trajectory or a map, and does it meet the limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli import completion
from sfr_loc_map.cli.align import (
    EVO_SUFFIXES,
    AlignOption,
    EvoOption,
    MaxDifferenceOption,
    RpeDeltaOption,
    aligned_config,
    save_evo,
)
from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import ConditionOption
from sfr_loc_map.cli.convention import ApplyDiagnosisOption, ConventionOption, read_correction
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import (
    HTML_SUFFIXES,
    STANDARD_OUTPUT,
    HtmlOption,
    JsonOption,
    OverwriteOption,
    check_outputs,
    check_suffix,
    say,
    show,
    warn,
)
from sfr_loc_map.cli.verdict import LenientOption, conclude, read_limits
from sfr_loc_map.errors import ConfigError, MissingExtraError

if TYPE_CHECKING:
    from sfr_loc_map.metrics.score import Score
    from sfr_loc_map.pipeline.score_inputs import ScoreInputs
    from sfr_loc_map.pipeline.scoring import Run

LimitsOption = Annotated[
    Path | None, typer.Option("--limits", metavar="F.yaml", help="Limits; exit code 1 if one is missed.")
]
StatsOption = Annotated[
    list[Path] | None,
    typer.Option(metavar="S.csv", help="Calls (time, memory, state, covariance); repeatable."),
]
TargetOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Name of the target that --target-timing was measured on.")
]
TargetTimingOption = Annotated[
    Path | None,
    typer.Option(metavar="S.csv", help="Calls on the target: processing_time_s, state, peak_rss_bytes."),
]
RangeOption = Annotated[
    tuple[float, float],
    typer.Option("--range", metavar="FROM_M TO_M", help="Ranges of the truth that count for coverage."),
]
FusedOption = Annotated[
    bool | None,
    typer.Option("--fused/--not-fused", help="Whether the cloud is fused, for a file that does not say so."),
]
AssociateOption = Annotated[
    str,
    typer.Option(
        metavar="auto|match|interpolate",
        help="How an estimate finds its truth.",
        autocompletion=completion.words("auto", "match", "interpolate"),
    ),
]
RebaseOption = Annotated[
    str,
    typer.Option(
        metavar="pose|position",
        help="Taken from the estimate at a start.",
        autocompletion=completion.words("pose", "position"),
    ),
]
MaxGapOption = Annotated[float, typer.Option(metavar="S", help="Longest gap of the truth that is interpolated.")]
SpacingOption = Annotated[int, typer.Option(metavar="FRAMES", help="Frames from one start to the next.")]


@app.command(
    epilog=examples(
        "sfr score estimate.csv data/ --condition distance=5 --condition time=60",
        "sfr score cloud.ply data/ --limits limits.yaml --json score.json --html score.html",
        "sfr score estimate.csv truth.tum --json -",
        "sfr score estimate.kitti truth.kitti --align se3",
        "sfr score orbslam.tum data/ --convention frame=left_optical --convention world=first_pose",
    )
)
def score(
    estimate: Annotated[
        Path, typer.Argument(metavar="EST", help="Trajectory (csv, TUM, KITTI, EuRoC, evo, bag) or cloud.")
    ],
    truth: Annotated[
        Path, typer.Argument(metavar="TRUTH", help="Trajectory, bag or data set; for a cloud a source with truth.")
    ],
    condition: ConditionOption = None,
    spacing: SpacingOption = 10,
    rebase: RebaseOption = "pose",
    limits: LimitsOption = None,
    stats: StatsOption = None,
    target: TargetOption = None,
    target_timing: TargetTimingOption = None,
    associate: AssociateOption = "auto",
    max_gap: MaxGapOption = 1.0,
    scored_range: RangeOption = (0.0, 10.0),
    fused: FusedOption = None,
    align: AlignOption = None,
    max_difference: MaxDifferenceOption = None,
    rpe_delta: RpeDeltaOption = None,
    evo: EvoOption = None,
    convention: ConventionOption = None,
    apply_diagnosis: ApplyDiagnosisOption = False,
    json_path: JsonOption = None,
    html: HtmlOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Score an estimate against the truth: exit 1 if a limit is missed, 3 if something could not be judged."""
    from sfr_loc_map.metrics.config import score_config
    from sfr_loc_map.pipeline.scoring import converted_run, score_run

    parsed_limits, asked = read_limits(limits, condition)
    config = score_config(condition, _settings(spacing, rebase, associate, max_gap, scored_range))
    inputs = _inputs(estimate, truth, stats, target, target_timing)
    aligned = aligned_config(align, max_difference, rpe_delta, evo, has_poses=inputs.estimate is not None)
    check_suffix(html, HTML_SUFFIXES)
    check_suffix(evo, EVO_SUFFIXES)
    check_outputs(json_path, html, evo, overwrite=overwrite, inputs=(estimate, truth, *inputs.stats))
    correction = read_correction(convention, apply_diagnosis, has_poses=inputs.estimate is not None)
    run = converted_run(_run(inputs, fused), config, correction)
    result = score_run(run, config, parsed_limits, aligned)
    present(result, json_path, html)
    save_evo(evo, run, aligned)
    _propose(result, (estimate, truth), json_path, html)
    conclude(result, asked, lenient=lenient)


def _settings(
    spacing: int, rebase: str, associate: str, max_gap: float, scored_range: tuple[float, float]
) -> dict[str, object]:
    """Return options by the names of the settings."""
    return {
        "trajectory.spacing": spacing,
        "trajectory.rebase": rebase,
        "trajectory.association.truth": associate,
        "trajectory.association.max_gap_s": max_gap,
        "map.scored_from_m": scored_range[0],
        "map.scored_to_m": scored_range[1],
    }


def _inputs(
    estimate: Path, truth: Path, stats: list[Path] | None, target: str | None, target_timing: Path | None
) -> ScoreInputs:
    """Return the files of a score.

    Raises:
        ConfigError: If one of the options of the target is missing.
    """
    from sfr_loc_map.pipeline.score_inputs import ScoreInputs

    if (target is None) != (target_timing is None):
        raise ConfigError("'--target' and '--target-timing' belong together: give the name and the file")
    return replace(ScoreInputs.of(estimate, truth, stats or ()), target=target_timing, target_name=target or "")


def _run(inputs: ScoreInputs, fused: bool | None) -> Run:
    """Read the files of a score, and say which foreign formats were found."""
    from sfr_loc_map.pipeline.scoring import load_run

    run = load_run(inputs, fused)
    for note in run.notes:
        say(note, err=True)
    return run


def present(score: Score, json_path: str | None, html: Path | None) -> None:
    """Write and print a score.

    Raises:
        ConfigError: If there is nothing in it.
    """
    from sfr_loc_map.metrics.score_json import to_json
    from sfr_loc_map.report.score_tables import summary_tables

    tables = summary_tables(score)
    if not tables and json_path != STANDARD_OUTPUT:
        raise ConfigError("nothing was scored: give an estimate and its truth")
    show(to_json(score), json_path, tables)
    if json_path != STANDARD_OUTPUT:
        _say_verdict(score)
    if html is not None:
        _write_page(score, html)
    for finding in score.findings:
        warn(f"method {score.method.name if score.method else 'under test'}: {finding}")
    for warning in score.warnings:
        if warning != score.contradiction:  # that ends the command
            warn(warning)


def _propose(score: Score, inputs: tuple[Path, Path], json_path: str | None, html: Path | None) -> None:
    """Propose what is useful after a score."""
    if json_path == STANDARD_OUTPUT:
        return
    if score.contradiction is not None:
        propose("sfr", "doctor", *inputs, why="which convention mismatch it is, and what corrects it")
    elif html is not None:
        propose(f"open {html} in a browser")
    elif not score.verdicts:
        propose("sfr init    # limits to fill in; then: sfr score ... --limits limits.yaml --html report.html")
    elif json_path is not None:
        propose("sfr", "report", json_path, why="the same as a page with figures")
    else:  # the options are left to the reader: without them it would be another score
        propose("sfr score ... --html report.html", why="the same command, with a page of figures")


def _say_verdict(score: Score) -> None:
    """Say the verdict over all limits, and what to look at first."""
    from sfr_loc_map.report.look_first import look_first
    from sfr_loc_map.report.overall import overall_of

    if score.verdicts:
        overall = overall_of(score)
        say(f"verdict: {overall.state}. {overall.text}")
    for item in look_first(score)[:1]:
        say(f"look at this first: {item.what}. {item.why}")


def _write_page(score: Score, html: Path) -> None:
    from importlib import import_module

    try:
        page = import_module("sfr_loc_map.report.page")
    except ImportError as error:
        raise MissingExtraError(f"the report page is not available ({error}): leave out --html") from error
    page.write_page(score, html)
