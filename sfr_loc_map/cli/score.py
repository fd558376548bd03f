"""`sfr score`: how good is a trajectory or a map, and does it meet the limits."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import (
    Align,
    ColumnsOption,
    ConfigOption,
    ConventionOptions,
    JudgeOptions,
    OutputOptions,
    PartialOption,
    RebaseOption,
    SpacingOption,
    columns_of,
    named_beside,
    parse_settings,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, beside, check_suffix, say, show, warn
from sfr_loc_map.cli.verdict import conclude, not_judged
from sfr_loc_map.config import build, flatten
from sfr_loc_map.errors import ConfigError, FailedVerdictError
from sfr_loc_map.io.atomic import write_text
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.metrics.config import ScoreConfig, aligned_error_config, score_config

if TYPE_CHECKING:
    from sfr_loc_map.metrics.score import Score


SHOWN_HYPOTHESES = 5
TABLE_SUFFIXES = (".parquet", ".csv")


@app.command(
    epilog=examples(
        "sfr score estimate.csv data/ --condition distance=5 --condition time=60",
        "sfr score cloud.ply data/ --limits limits.yaml --json score.json --html score.html",
        "sfr score estimate.csv truth.tum --json -",
        "sfr score estimate.kitti truth.kitti --align se3",
        "sfr score orbslam.tum data/ --convention frame=left_optical --convention world=first_pose",
    ),
    first="html json_path overwrite limits condition stats align partial convention apply_diagnosis junit",
)
def score(
    estimate: Annotated[Path, Argument(metavar="EST", help="Trajectory (csv, TUM, KITTI, EuRoC, bag) or cloud.")],
    truth: Annotated[
        Path, Argument(metavar="TRUTH", help="Trajectory, bag or data set; for a cloud a source with truth.")
    ],
    judge: JudgeOptions,
    conversion: ConventionOptions,
    output: OutputOptions,
    spacing: SpacingOption = 10,
    rebase: RebaseOption = "pose",
    partial: PartialOption = False,
    frames: Annotated[
        Literal["truth", "images"],
        Option(help="What frames are: true poses; or estimates, with the truth interpolated."),
    ] = "truth",
    stats: Annotated[
        list[Path] | None, Option(metavar="S.csv", help="Calls (time, memory, state, covariance); repeatable.")
    ] = None,
    target: Annotated[
        str | None, Option(metavar="NAME", help="Name of the target that --target-timing was measured on.")
    ] = None,
    target_timing: Annotated[
        Path | None, Option(metavar="S.csv", help="Calls on the target: processing_time_s, state, peak_rss_bytes.")
    ] = None,
    target_run: Annotated[
        str | None, Option(metavar="TEXT", help="Which run --target-timing is of, where not the estimate's.")
    ] = None,
    junit: Annotated[Path | None, Option(metavar="F.xml", help="Write the verdicts as JUnit XML.")] = None,
    points: Annotated[
        Path | None, Option(metavar="F.parquet|F.csv", help="Write every map point, its ground truth and its error.")
    ] = None,
    pieces: Annotated[
        Path | None,
        Option(metavar="F.parquet|F.csv", help="Write every sub-trajectory: frames, displacements, errors."),
    ] = None,
    associate: Annotated[
        Literal["auto", "match", "interpolate"], Option(help="How an estimate finds its truth.")
    ] = "auto",
    max_gap: Annotated[float, Option(metavar="S", help="Longest gap of the truth that is interpolated.")] = 1.0,
    scored_range: Annotated[
        tuple[float, float],
        Option("--range", metavar="FROM_M TO_M", help="Ranges of the truth that count for coverage."),
    ] = (0.0, 10.0),
    fused: Annotated[
        bool | None, Option("--fused/--not-fused", help="Whether the cloud is fused, for a file that does not say so.")
    ] = None,
    align: Annotated[
        Align | None, Option(help="Also APE (ATE) and RPE after this alignment; other figures stay unaligned.")
    ] = None,
    max_difference: Annotated[
        float | None, Option(metavar="S", help="Of stamps paired for APE and RPE.", show_default="0.01")
    ] = None,
    rpe_delta: Annotated[
        str | None, Option(metavar="frames=N|distance=M", help="Length of a relative error.", show_default="frames=1")
    ] = None,
    diagnose: Annotated[
        bool, Option(help="Show which convention mismatch explains the disagreement; exit 1 if one does.")
    ] = False,
    columns: ColumnsOption = None,
    config_file: ConfigOption = None,
    settings: Annotated[
        list[str] | None,
        Option("--set", metavar="truth.KEY=VALUE", help="Of the truth, as truth.sigma_m=0.02; repeatable."),
    ] = None,
) -> None:
    """Score an estimate against the truth: exit 1 if a limit is missed, 3 if something could not be judged."""
    from sfr_loc_map.io.source_config import source_config
    from sfr_loc_map.io.truth import TruthConfig
    from sfr_loc_map.metrics.cloud_error import points_table
    from sfr_loc_map.metrics.trajectory_score import pieces_table
    from sfr_loc_map.report.test_report import junit as junit_of
    from sfr_loc_map.scoring.score_run import ScoreInputs, converted_run, load_run, save_table, score_run

    if diagnose:
        output.check()
        _diagnose(estimate, truth, output.json_path, lenient=judge.lenient)
        return
    has_pairs = truth.is_dir() or is_bag(truth)
    config_file = config_file or (named_beside(truth) if has_pairs else None)
    judge = judge.by(config_file)
    limits, asked = judge.read()
    of_score: dict[str, object] = {
        "trajectory.spacing": spacing,
        "trajectory.rebase": rebase,
        "trajectory.partial": partial,
        "trajectory.association.truth": "interpolate" if frames == "images" else associate,
        "trajectory.association.max_gap_s": max_gap,
        "map.scored_from_m": scored_range[0],
        "map.scored_to_m": scored_range[1],
    }
    if frames == "images" and associate == "match":
        raise ConfigError("'--frames images' interpolates the truth, '--associate match' does not: leave one out")
    config = score_config(judge.condition, of_score)
    if (target is None) != (target_timing is None):
        raise ConfigError("'--target' and '--target-timing' belong together: give the name and the file")
    inputs = ScoreInputs.of(estimate, truth, stats or ())
    of_estimate, columns_of_truth = columns_of(columns)
    inputs = replace(inputs, columns=of_estimate)
    if config_file is not None or settings or columns_of_truth:
        how = source_config(truth, config_file)
        given = {key.removeprefix("truth."): value for key, value in parse_settings(settings).items()}
        given |= {"columns": columns_of_truth} if columns_of_truth else {}
        named = flatten(how.truth) | ({} if has_pairs else {"source": ""})  # TRUTH itself is the file
        of_truth = build(TruthConfig, {**named, **given}, origin="--set truth.KEY=VALUE")
        inputs = replace(inputs, config=replace(how, truth=of_truth))
    if target_timing is not None:
        inputs = replace(inputs, target=target_timing, target_about=None, target_name=target or "")
    if target_run is not None and inputs.target is None:
        raise ConfigError(
            "'--target-run' says which run the times of a target are of: give --target and --target-timing"
        )
    command = shlex.join(["sfr", *sys.argv[1:]])
    inputs = replace(inputs, target_run=target_run, limits=judge.limits, command=command)
    has_poses = inputs.estimate is not None
    if align is not None and not has_poses:
        raise ConfigError("'--align' is for trajectories: leave it out for a cloud")
    aligned = aligned_error_config(align, {"max_difference_s": max_difference, "rpe_delta": rpe_delta})
    for table in (points, pieces):
        check_suffix(table, TABLE_SUFFIXES)
    output.check(junit, points, pieces)
    correction = conversion.read(has_poses=has_poses)
    loaded = load_run(inputs, fused)
    for note in () if loaded.drive is None else loaded.drive.notes:
        say(note, err=True)
    run = converted_run(loaded, config, correction)
    cloud = None if run.cloud is None else run.cloud.loaded.cloud
    if points is not None and cloud is None:
        raise ConfigError("'--points' writes errors of map points: give a cloud that says pixel and pair of each")
    if pieces is not None and run.drive is None:
        raise ConfigError("'--pieces' writes sub-trajectories: give a trajectory and its ground truth")
    result = score_run(run, config, limits, aligned)
    present(result, output.json_path, output.html)
    if junit is not None:
        with beside():
            write_text(junit_of({"score 1": result}), junit)
    if points is not None and cloud is not None and run.cloud is not None:
        with beside():
            save_table(points, points_table(cloud, run.cloud.truths))
    if pieces is not None and run.drive is not None:
        with beside():
            save_table(pieces, pieces_table(run.drive.estimates, run.drive.truth, config.trajectory))
    _propose_next(result, output)
    conclude(result, asked, lenient=judge.lenient)


def _propose_next(result: Score, output: OutputOptions) -> None:
    """Propose what is useful after a score, unless a program reads the JSON."""
    if output.json_path == STANDARD_OUTPUT:
        return
    if result.incomplete is not None:
        propose("... --partial", why="judges the part that is there")
    elif result.contradiction is not None:
        propose("... --diagnose", why="which convention mismatch it is, and what corrects it")
    elif output.html is not None:
        propose(f"open {output.html} in a browser")
    elif not result.verdicts:
        propose("... --limits limits.yaml --html report.html", why="sfr init writes limits to fill in")
    elif output.json_path is not None:
        propose("sfr", "report", output.json_path, why="the same as a page with figures")
    else:
        propose("... --html report.html", why="the same command, with a page of figures")


def present(score: Score, json_path: str | None, html: Path | None) -> None:
    """Write and print a score, its verdict and what to look at first; raise ConfigError if there is nothing in it."""
    from sfr_loc_map.metrics.score_json import to_dict
    from sfr_loc_map.report.page import look_first, overall_of, run_facts, write_page
    from sfr_loc_map.report.score_tables import summary_tables

    tables = summary_tables(score)
    if not tables and json_path != STANDARD_OUTPUT:
        raise ConfigError("nothing was scored: give an estimate and its truth")
    show(to_dict(score), json_path, tables)
    if json_path != STANDARD_OUTPUT:
        if score.incomplete is not None:
            say(f"incomplete: {score.incomplete}")
        if score.verdicts:
            facts, overall, made = dict(run_facts(score)), overall_of(score), score.provenance
            limits = None if made is None else made.inputs.get("limits")
            by = "" if limits is None else f"; by {limits.path}"
            say(f"judged: {'; '.join(facts[name] for name in ('Drive', 'Map') if name in facts)}{by}")
            say(f"verdict: {overall.state}. {overall.text}")
        for item in look_first(score)[:1]:
            say(f"look at this first: {item.what}. {item.why}")
    if html is not None:
        with beside():
            write_page(score, html)
    for finding in score.findings:
        warn(f"method {score.method.name if score.method else 'under test'}: {finding}")
    for warning in score.warnings:
        if warning != score.contradiction:  # that ends the command
            warn(warning)


def _diagnose(estimate: Path, truth: Path, json_path: str | None, *, lenient: bool) -> None:
    """Show what explains the disagreement of estimate and truth; raise FailedVerdictError if something does.

    The disagreement is the mean error of position per distance travelled and of attitude in radians, re-based at many
    starts.
    """
    from sfr_loc_map.metrics.convention import MIN_POSES
    from sfr_loc_map.report.tables import Cell, Column, Table
    from sfr_loc_map.scoring.score_run import diagnose_files

    diagnosis = diagnose_files(estimate, truth, ScoreConfig())
    rows = [(Cell.head("as it is"), Cell.number(diagnosis.disagreement, undefined="no stamp in common"), Cell(""))]
    rows += [
        (Cell.head(f"without: {item.mismatch}"), Cell.number(item.disagreement), Cell(item.setting))
        for item in diagnosis.hypotheses[:SHOWN_HYPOTHESES]
    ]
    columns = (Column("convention", words=True), Column("disagreement"), Column("corrected by", words=True))
    show(diagnosis, json_path, [Table("conventions", "Estimate against truth", columns, tuple(rows))])
    if diagnosis.found is not None:
        if json_path != STANDARD_OUTPUT:
            say(diagnosis.found.sentence)
            if diagnosis.found.setting:
                say(f"sfr score ... --convention {diagnosis.found.setting} corrects it")
        raise FailedVerdictError(f"estimate and truth contradict each other by convention: {diagnosis.found.mismatch}")
    if diagnosis.disagreement is None:
        not_judged([f"'{estimate}' and '{truth}' have fewer than {MIN_POSES} stamps in common"], lenient=lenient)
    elif json_path != STANDARD_OUTPUT:
        say("no single convention mismatch explains the disagreement, if there is any")
