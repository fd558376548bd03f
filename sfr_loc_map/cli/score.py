"""`sfr score`: evaluate a trajectory or a map against the truth and judge the figures by limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from typer import Argument, Context, Option

from sfr_loc_map.cli.app import app, command_line, current_run, examples, propose, propose_again, propose_page
from sfr_loc_map.cli.options import (
    ASSOCIATION,
    CLOUDS,
    CONVENTION,
    DEFAULT_ASSOCIATION,
    DEFAULT_REBASE,
    SCORE,
    TABLES,
    TRAJECTORIES,
    Align,
    ApplyDiagnosisOption,
    Association,
    ColumnsOption,
    ConditionOption,
    ConfigOption,
    ConventionOption,
    HtmlOption,
    JsonOption,
    LenientOption,
    LimitsOption,
    OverwriteOption,
    PartialOption,
    RebaseOption,
    SpacingOption,
    announced_config,
    columns_of,
    given_words,
    of_panels,
    option_names,
    parse_settings,
    refuse_given,
    refuse_others,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, check_suffix, claim_outputs, say, secondary_output, show
from sfr_loc_map.cli.verdict import NO_LIMITS, conclude, not_judged, present, write_junit
from sfr_loc_map.errors import ConfigError, FailedVerdictError
from sfr_loc_map.io.source_format import is_bag
from sfr_loc_map.metrics.config import AlignedErrorConfig, ScoreConfig
from sfr_loc_map.suffixes import HTML_SUFFIXES

if TYPE_CHECKING:
    from sfr_loc_map.io.source_config import SourceConfig
    from sfr_loc_map.metrics.config import TrajectoryScoreConfig
    from sfr_loc_map.metrics.score.score import Score
    from sfr_loc_map.scoring.inputs import ScoreInputs
    from sfr_loc_map.scoring.request import ScoredRun, ScoreRequest


TABLE_SUFFIXES = (".parquet", ".csv")
TARGET = "Calls on a target"
ALIGNED = AlignedErrorConfig()  #: Default settings of APE and RPE.
OF_DIAGNOSIS = ("estimate", "truth", "diagnose", "json_path", "overwrite", "lenient", "config_file")
"""Arguments and options that apply to `--diagnose`, in addition to those that select the compared poses."""

# ---- options of this command

EstimateArgument = Annotated[Path, Argument(metavar="EST", help="Trajectory (csv, TUM, KITTI, EuRoC, bag) or cloud.")]
TruthArgument = Annotated[
    Path, Argument(metavar="TRUTH", help="Ground truth: trajectory, bag or data set; for a cloud, a data set.")
]
StatsOption = Annotated[
    list[Path] | None,
    Option(
        metavar="S.csv",
        help="Calls of the run (--stats of sfr localise or map): time, state, covariance, ...; repeatable; "
        "default: EST.stats.csv if it exists.",
    ),
]
AlignOption = Annotated[
    Align | None,
    Option(
        rich_help_panel=TRAJECTORIES,
        help="Also report APE (ATE) and RPE after this alignment; the other figures use no alignment.",
    ),
]
JunitOption = Annotated[Path | None, Option(metavar="F.xml", help="Write the verdicts as JUnit XML.")]
DiagnoseOption = Annotated[
    bool,
    Option(
        "--diagnose",
        rich_help_panel=CONVENTION,
        help="Do not score: search for a convention mismatch between EST and TRUTH; exit with 1 if one is found.",
    ),
]
FramesOption = Annotated[
    Literal["truth", "images"],
    Option(
        rich_help_panel=ASSOCIATION,
        help="Frames of the score: the true poses (truth), or the estimates with interpolated truth (images).",
    ),
]
AssociateOption = Annotated[
    Association,
    Option(
        rich_help_panel=ASSOCIATION,
        help="Truth of an estimate: the true pose of the same stamp (match), or interpolated (interpolate).",
    ),
]
MaxGapOption = Annotated[
    float,
    Option(metavar="S", rich_help_panel=ASSOCIATION, help="Longest gap of the truth in which it is interpolated."),
]
ScoredRangeOption = Annotated[
    tuple[float, float],
    Option(
        "--range",
        metavar="FROM_M TO_M",
        rich_help_panel=CLOUDS,
        help="Range interval of the true points that count for coverage.",
    ),
]
FusedOption = Annotated[
    bool | None,
    Option(
        "--fused/--not-fused",
        rich_help_panel=CLOUDS,
        help="Whether the cloud is fused, if its file does not state this.",
    ),
]
MaxDifferenceOption = Annotated[
    float | None,
    Option(
        metavar="S",
        rich_help_panel=TRAJECTORIES,
        help="Maximum stamp difference of paired poses for APE and RPE.",
        show_default=str(ALIGNED.max_difference),
    ),
]
RpeDeltaOption = Annotated[
    str | None,
    Option(
        metavar="frames=N|distance=M",
        rich_help_panel=TRAJECTORIES,
        help="Length of a relative motion (RPE).",
        show_default=ALIGNED.rpe_delta,
    ),
]
PointsOption = Annotated[
    Path | None,
    Option(
        metavar="F.parquet|F.csv", rich_help_panel=CLOUDS, help="Write every map point, its ground truth and its error."
    ),
]
PiecesOption = Annotated[
    Path | None,
    Option(
        metavar="F.parquet|F.csv",
        rich_help_panel=TRAJECTORIES,
        help="Write every sub-trajectory: frames, displacements, errors.",
    ),
]
TargetOption = Annotated[
    str | None,
    Option(metavar="NAME", rich_help_panel=TARGET, help="Name of the target on which --target-timing was measured."),
]
TargetTimingOption = Annotated[
    Path | None,
    Option(
        metavar="S.csv", rich_help_panel=TARGET, help="Calls on the target: processing_time_s, state, peak_rss_bytes."
    ),
]
TargetRunOption = Annotated[
    str | None,
    Option(metavar="TEXT", rich_help_panel=TARGET, help="Name of the other run from which --target-timing comes."),
]
SettingsOption = Annotated[
    list[str] | None,
    Option(
        "--set",
        metavar="truth.KEY=VALUE",
        rich_help_panel=ASSOCIATION,
        help="Setting of the truth, for example truth.sigma_m=0.02; repeatable.",
    ),
]


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
    context: Context,
    estimate: EstimateArgument,
    truth: TruthArgument,
    html: HtmlOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    limits: LimitsOption = None,
    conditions: ConditionOption = None,
    stats: StatsOption = None,
    align: AlignOption = None,
    partial: PartialOption = False,
    junit: JunitOption = None,
    lenient: LenientOption = False,
    convention: ConventionOption = None,
    apply_diagnosis: ApplyDiagnosisOption = False,
    diagnose: DiagnoseOption = False,
    spacing: SpacingOption = SCORE.trajectory.spacing,
    rebase: RebaseOption = DEFAULT_REBASE,
    frames: FramesOption = "truth",
    associate: AssociateOption = DEFAULT_ASSOCIATION,
    max_gap: MaxGapOption = SCORE.trajectory.association.max_gap_s,
    scored_range: ScoredRangeOption = (SCORE.map.scored_from_m, SCORE.map.scored_to_m),
    fused: FusedOption = None,
    max_difference: MaxDifferenceOption = None,
    rpe_delta: RpeDeltaOption = None,
    points: PointsOption = None,
    pieces: PiecesOption = None,
    target: TargetOption = None,
    target_timing: TargetTimingOption = None,
    target_run: TargetRunOption = None,
    columns: ColumnsOption = None,
    config_file: ConfigOption = None,
    settings: SettingsOption = None,
) -> None:
    """Score an estimate against the truth: exit 1 if a limit is missed, 3 if something could not be judged."""
    from sfr_loc_map.io.source_config import with_truth_settings
    from sfr_loc_map.scoring.inputs import ScoreInputs
    from sfr_loc_map.scoring.judgement import Judgement, limits_file_of
    from sfr_loc_map.scoring.request import ScoreRequest

    found = ScoreInputs.of(estimate, truth, stats)
    _check_options(context, found, diagnose=diagnose)
    source_config = _configuration_of_truth(truth, config_file)
    of_estimate, of_truth = columns_of(columns)
    configured = with_truth_settings(truth, source_config, parse_settings(settings), of_truth)
    inputs = replace(
        found, columns=of_estimate, config=configured, limits=limits_file_of(limits, source_config.configuration)
    )
    inputs = _measured_on(inputs, target, target_timing, target_run)
    outputs = _Outputs(json_path, html, junit, points, pieces)
    outputs.claim((estimate, truth, *inputs.paths), overwrite=overwrite)
    judgement = Judgement.of(limits, conditions, source_config.configuration)
    request = ScoreRequest.of(
        judgement.conditions,
        judgement.limits,
        spacing=spacing,
        rebase=rebase,
        partial=partial,
        frames=frames,
        associate=associate,
        max_gap=max_gap,
        scored_range=scored_range,
        align=align,
        max_difference=max_difference,
        rpe_delta=rpe_delta,
        convention=convention or (),
        apply_diagnosis=apply_diagnosis,
        called=option_names(context),
    )
    if diagnose:
        _diagnose(inputs, request.config, json_path, lenient=lenient)
        return
    result = _scored(inputs, request, outputs, fused)
    _propose_next(context, (estimate, truth), result, outputs, overwrite=overwrite)
    conclude(result, judgement.asked, lenient=lenient)
    if junit is not None and not result.is_judged:
        not_judged([NO_LIMITS], lenient=lenient)


def _configuration_of_truth(truth: Path, config_file: Path | None) -> SourceConfig:
    """Return how the truth is read; a file of poses uses no `sfr.yaml` beside it."""
    from sfr_loc_map.io.source_config import DEFAULT_SOURCE

    is_configured = config_file is not None or truth.is_dir() or is_bag(truth)
    return announced_config(truth, config_file) if is_configured else DEFAULT_SOURCE


def _check_options(context: Context, given: ScoreInputs, *, diagnose: bool) -> None:
    """Raise ConfigError if an option does not apply to the kind of the estimate, or to a diagnosis."""
    if given.estimate is None:
        of_trajectories = of_panels(context, TRAJECTORIES, ASSOCIATION, TABLES, CONVENTION)
        refuse_given(context, of_trajectories, "applies only to trajectories: omit it for a cloud")
    if given.cloud is None:
        refuse_given(context, of_panels(context, CLOUDS), "applies only to clouds: omit it for a trajectory")
    if diagnose:
        of_diagnosis = (*OF_DIAGNOSIS, *of_panels(context, ASSOCIATION, TABLES))
        refuse_others(context, of_diagnosis, "has no effect with --diagnose, which makes no score: omit it")


def _measured_on(inputs: ScoreInputs, target: str | None, timing: Path | None, run: str | None) -> ScoreInputs:
    """Return the inputs with the calls on the target; raise ConfigError if one of the options is missing."""
    if (target is None) != (timing is None):
        raise ConfigError(
            "'--target' (the name) and '--target-timing' (the calls measured on it) belong together: give both"
        )
    if timing is not None:
        inputs = replace(inputs, target=timing, target_about=None, target_name=target or "")
    if run is not None and inputs.target is None:
        raise ConfigError(
            "'--target-run' names the run in which the calls of --target-timing were measured: give --target and "
            "--target-timing, too"
        )
    return replace(inputs, target_run=run)


class _Outputs(NamedTuple):
    """Files that the command writes; None if a file is not requested. The JSON may be standard output."""

    json: str | None
    html: Path | None
    junit: Path | None
    points: Path | None
    pieces: Path | None

    def claim(self, inputs: Sequence[Path], *, overwrite: bool) -> None:
        """Raise OutputError if a file cannot be written, or is one of the inputs."""
        check_suffix(self.html, HTML_SUFFIXES)
        for table in (self.points, self.pieces):
            check_suffix(table, TABLE_SUFFIXES)
        claim_outputs(*self, inputs=inputs, overwrite=overwrite)

    def write(self, scored: ScoredRun, config: TrajectoryScoreConfig) -> None:
        """Print the score, and write all requested files; `config` are the settings of its trajectory."""
        from sfr_loc_map.cli.table_file import save_table
        from sfr_loc_map.metrics.map.point_errors import points_table
        from sfr_loc_map.metrics.trajectory.trajectory_score import sub_trajectory_table

        present(scored.score, self.json, self.html)
        if self.junit is not None:
            with secondary_output():
                write_junit([scored.score], self.junit)
        made, drive = scored.run.cloud, scored.run.drive
        if self.points is not None and made is not None and made.loaded.cloud is not None:
            with secondary_output():
                save_table(self.points, points_table(made.loaded.cloud, made.truths))
        if self.pieces is not None and drive is not None:
            with secondary_output():
                table = sub_trajectory_table(drive.estimates, drive.truth, config, drive.image_stamps_ns)
                save_table(self.pieces, table)


def _scored(inputs: ScoreInputs, request: ScoreRequest, outputs: _Outputs, fused: bool | None) -> Score:
    """Read the files, score the run and write the outputs; return the score."""
    from sfr_loc_map.scoring.load import load_run

    loaded = load_run(inputs, fused, command=command_line())
    for note in () if loaded.drive is None else loaded.drive.notes:
        say(note, err=True)
    if outputs.points is not None and (loaded.cloud is None or loaded.cloud.loaded.cloud is None):
        raise ConfigError("'--points' writes errors of map points: give a cloud with the pixel and pair of each point")
    scored = request.scored(loaded)
    outputs.write(scored, request.config.trajectory)
    return scored.score


def _propose_next(
    context: Context, scored: tuple[Path, Path], result: Score, outputs: _Outputs, *, overwrite: bool
) -> None:
    """Propose the next command after a score; `scored` are the estimate and the truth of the command line."""
    from sfr_loc_map.metrics.judging.incomplete import is_lifted_by_partial

    again = ["--overwrite"] if current_run().outputs and not overwrite else []
    if result.incomplete is not None and is_lifted_by_partial(result):
        propose_again(*again, "--partial", why="judges the part that the estimate covers")
    elif result.contradiction is not None:
        compared = given_words(context, *of_panels(context, ASSOCIATION, TABLES), "config_file")
        propose(
            "sfr", "score", *scored, *compared, "--diagnose", why="finds the convention mismatch and its correction"
        )
    elif outputs.html is not None:
        propose_page(outputs.html)
    elif not result.verdicts:
        propose_again(*again, "--limits limits.yaml --html report.html", why="sfr init writes limits to fill in")
    elif outputs.json is not None:
        propose("sfr", "report", outputs.json, why="the same as a page with figures")
    else:
        propose_again(*again, "--html report.html", why="the same command, with a page of figures")


def _diagnose(inputs: ScoreInputs, config: ScoreConfig, json_path: str | None, *, lenient: bool) -> None:
    """Show the convention mismatches that may explain the disagreement; raise FailedVerdictError if one does.

    The disagreement is the root sum of squares of the position error per distance travelled and the attitude error in
    radians, re-based at each start and averaged over sub-trajectories.
    """
    from sfr_loc_map.metrics.conventions.convention_diagnosis import NEGLIGIBLE
    from sfr_loc_map.metrics.conventions.disagreement import MIN_POSES
    from sfr_loc_map.report.diagnosis_table import diagnosis_table
    from sfr_loc_map.scoring.conversion import diagnose_run
    from sfr_loc_map.scoring.load import load_run

    diagnosis = diagnose_run(load_run(inputs), config)
    show(diagnosis, json_path, [diagnosis_table(diagnosis)])
    if diagnosis.found is not None:
        if json_path != STANDARD_OUTPUT:
            say(diagnosis.found.sentence)
            if diagnosis.found.setting:
                say(f"sfr score ... --convention {diagnosis.found.setting} corrects it")
        advice = f": score again with --convention {diagnosis.found.setting}" if diagnosis.found.setting else ""
        raise FailedVerdictError(f"estimate and truth use different conventions ({diagnosis.found.mismatch}){advice}")
    if diagnosis.disagreement is None:
        not_judged(
            [f"'{inputs.estimate}' and '{inputs.truth}' have fewer than {MIN_POSES} stamps in common"], lenient=lenient
        )
    elif json_path != STANDARD_OUTPUT:
        disagreement = (
            f"{diagnosis.disagreement:.3g} (root sum of squares of the position error per distance travelled and the "
            "attitude error in rad)"
        )
        if diagnosis.disagreement < NEGLIGIBLE:
            say(f"estimate and truth use the same conventions: their mean disagreement is {disagreement}")
        else:
            say(
                f"no single convention mismatch explains the mean disagreement of {disagreement}: the estimate has "
                "errors, or several conventions differ"
            )
