"""`sfr replay`: play a source to the three nodes or an external node over topics, and score the results."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Context, Option

from sfr_loc_map.cli.app import app, command_line, examples, propose_again, propose_page
from sfr_loc_map.cli.live_option import LiveOption, PortOption, live_page
from sfr_loc_map.cli.options import (
    CONVENTION,
    DEFAULT_REBASE,
    METHOD,
    SCORE,
    TRAJECTORIES,
    ApplyDiagnosisOption,
    ConditionOption,
    ConfigOption,
    ConventionOption,
    LenientOption,
    LimitsOption,
    OverwriteOption,
    PartialOption,
    RebaseOption,
    RemapOption,
    SourceArgument,
    SpacingOption,
    StartOption,
    announced_config,
    of_panels,
    option_names,
    refuse_given,
    require_ros,
)
from sfr_loc_map.cli.output import claim_outputs, make_folder, progress_bar, say, warn
from sfr_loc_map.cli.verdict import conclude, present
from sfr_loc_map.errors import InterruptedRunError
from sfr_loc_map.live.config import DEFAULT_PORT
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.message_text import printable
from sfr_loc_map.suite_names import Task

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import Source
    from sfr_loc_map.live.page_process import PageProcess
    from sfr_loc_map.replay.files import ReplayFiles
    from sfr_loc_map.replay.options import ReplayOptions
    from sfr_loc_map.replay.replay_command import ScoredReplay

PLAYED = "Playback of the source"
UNDER_TEST = "External node in place of ours"

# ---- options of this command

OutOption = Annotated[Path | None, Option(metavar="DIR", help="Folder for report, estimate, statistics and cloud.")]
RateOption = Annotated[
    float,
    Option(
        min=0.0,
        metavar="R",
        rich_help_panel=PLAYED,
        help="0 (lock step): wait for the result of each pair. Otherwise: multiple of the recorded speed.",
    ),
]
StartOffsetOption = Annotated[
    float, Option(min=0.0, metavar="S", rich_help_panel=PLAYED, help="Seconds to skip at the start of the source.")
]
DurationOption = Annotated[
    float | None,
    Option(min=0.0, metavar="S", rich_help_panel=PLAYED, help="Seconds of the source that are played; default: all."),
]
StartPausedOption = Annotated[
    bool,
    Option(
        "--start-paused", rich_help_panel=PLAYED, help="Wait for the service /sfr_player/resume before the first pair."
    ),
]
ExternalOption = Annotated[
    Literal["localisation", "mapping"] | None,
    Option(rich_help_panel=METHOD, help="Replace our node of this task by a node of yours."),
]
MethodOption = Annotated[
    Literal["sfr", "external"],
    Option(rich_help_panel=METHOD, help="external: the same as --external, if SRC has pairs of one task."),
]
CommandOption = Annotated[
    str,
    Option(
        metavar="CMD",
        rich_help_panel=UNDER_TEST,
        help="Command that starts the external node, which is stopped after the replay.",
    ),
]
WatchOption = Annotated[
    str,
    Option(
        metavar="PID|NAME",
        rich_help_panel=UNDER_TEST,
        help="Process whose CPU and memory are measured, in addition to that of CMD: its id or a part of its "
        "command line.",
    ),
]
AnswersOption = Annotated[
    str,
    Option(
        metavar="TOPIC",
        rich_help_panel=UNDER_TEST,
        help="Topic of the answers (default: localisation/odometry or mapping/points).",
    ),
]
FramesOption = Annotated[
    str,
    Option(
        metavar="PARENT,CHILD",
        rich_help_panel=UNDER_TEST,
        help="Required frame ids of the answers; others are not used (default: the frame ids of the first answer).",
    ),
]
AnswerTimeoutOption = Annotated[
    float,
    Option(
        min=0.01,
        metavar="S",
        rich_help_panel=UNDER_TEST,
        help="Timeout for the answer to a pair; later answers are ignored.",
    ),
]


@app.command(
    epilog=examples(
        "sfr replay data/ --start truth --out out/",
        "sfr replay drive.mcap --rate 1 --duration 30 --out out/ --overwrite",
        "sfr replay data/ --limits limits.yaml --condition distance=10",
        "sfr replay data/ --external localisation --command 'python3 my_node.py' --convention frame=left_optical",
    )
)
def replay(
    context: Context,
    source: SourceArgument,
    out: OutOption = None,
    overwrite: OverwriteOption = False,
    start: StartOption = "identity",
    limits: LimitsOption = None,
    conditions: ConditionOption = None,
    partial: PartialOption = False,
    lenient: LenientOption = False,
    config: ConfigOption = None,
    remap: RemapOption = None,
    live: LiveOption = False,
    live_port: PortOption = DEFAULT_PORT,
    rate: RateOption = 0.0,
    start_offset: StartOffsetOption = 0.0,
    duration: DurationOption = None,
    start_paused: StartPausedOption = False,
    external: ExternalOption = None,
    method: MethodOption = "sfr",
    command: CommandOption = "",
    watch: WatchOption = "",
    answers: AnswersOption = "",
    frames: FramesOption = "",
    answer_timeout: AnswerTimeoutOption = 5.0,
    convention: ConventionOption = None,
    apply_diagnosis: ApplyDiagnosisOption = False,
    spacing: SpacingOption = SCORE.trajectory.spacing,
    rebase: RebaseOption = DEFAULT_REBASE,
) -> None:
    """Play a source to the three nodes over topics, collect their results and score them.

    The node /sfr_player offers the services ~/pause and ~/resume (std_srvs/Trigger). Ctrl-C ends the replay:
    the results up to then are scored and written, and the exit code is 130.

    With --external another node replaces ours. It subscribes to the images of its task and publishes nav_msgs/Odometry
    or sensor_msgs/PointCloud2 with the stamp of each pair. In lock step the replay waits for each answer
    (--answer-timeout). A crash or a missing answer is a finding, and the replay continues. See docs/candidates.md.
    """
    with live_page(context, live, live_port, isolated=True) as page:  # first, because its imports are faster
        if out is None:
            refuse_given(context, ("overwrite",), "replaces the files of a folder: give --out DIR, too")
        _refuse_options_of_external_node(context, external, method)
        from sfr_loc_map.io.registry import open_source
        from sfr_loc_map.replay.files import ReplayFiles
        from sfr_loc_map.scoring.judgement import Judgement
        from sfr_loc_map.scoring.provenance import check_data_set
        from sfr_loc_map.scoring.request import ScoreRequest

        source_config = announced_config(source, config, remap)
        opened = open_source(source, source_config)
        if opened.loc is None:
            of_drives = ("start", *of_panels(context, TRAJECTORIES))
            refuse_given(context, of_drives, f"applies to a drive, but '{source}' has only mapping pairs: omit it")
        judgement = Judgement.of(limits, conditions, source_config.configuration)
        check_data_set(opened, judgement.limits)
        request = ScoreRequest.of(
            judgement.conditions,
            judgement.limits,
            spacing=spacing,
            rebase=rebase,
            partial=partial,
            convention=convention or (),
            apply_diagnosis=apply_diagnosis,
            called=option_names(context),
        )
        require_ros("replay")
        from sfr_loc_map.replay.options import ReplayOptions, first_pose, node_under_test, task_under_test

        external_node = node_under_test(
            task_under_test(opened, external, method),
            answers=answers,
            command=command,
            watch=watch,
            frames=frames,
            timeout_s=answer_timeout,
            correction=request.correction,
        )
        options = ReplayOptions(
            localisation=source_config.configuration.build(LocalisationConfig, "localisation"),
            mapping=source_config.configuration.build(MappingConfig, "mapping"),
            configuration=source_config.configuration,
            request=request,
            limits_file=judgement.limits_file,
            start=first_pose(opened, start, start_offset),
            rate=rate or None,
            offset_s=start_offset,
            duration_s=math.inf if duration is None else duration,
            paused=start_paused,
            external=external_node,
        )
        files = None if out is None else ReplayFiles(out)
        with _room_for(files, (source, judgement.limits_file, source_config.configuration.path), overwrite=overwrite):
            outcome = _replay_and_present(opened, options, files, page)
        if outcome.interrupted:
            raise InterruptedRunError(outcome.interrupted)
        # without limits and conditions, a missing judgement is only a warning
        conclude(outcome.score, judgement.asked, lenient=lenient or not (judgement.limits_file or judgement.conditions))


def _refuse_options_of_external_node(context: Context, external: str | None, method: str) -> None:
    """Raise ConfigError for options of an external node without one, and for `--method` that contradicts it."""
    if method != "sfr":
        return
    if external is None:
        of_external = of_panels(context, UNDER_TEST, CONVENTION)
        refuse_given(context, of_external, "applies only to an external node: give --external TASK, too")
    else:
        refuse_given(context, ("method",), "contradicts --external: omit one of the two options")


@contextmanager
def _room_for(files: ReplayFiles | None, inputs: Iterable[Path | None], *, overwrite: bool) -> Iterator[None]:
    """Create the folder of the outputs, if any; remove it if nothing was written."""
    if files is None:
        yield
        return
    out = files.folder
    made = not out.exists()
    make_folder(out, "--out")
    try:
        claim_outputs(*files.all, inputs=inputs, overwrite=overwrite)
        yield
    finally:
        if made and not any(out.iterdir()):
            out.rmdir()


def _replay_and_present(
    source: Source, options: ReplayOptions, files: ReplayFiles | None, page: PageProcess | None
) -> ScoredReplay:
    """Replay and score with progress bars, and show the score on the live page.

    Print the score, and write report and page if files are given.
    """
    from sfr_loc_map.metrics.stored.score_json import to_json
    from sfr_loc_map.replay.replay_command import replay_and_score

    parts = ((Task.LOCALISATION, source.loc), (Task.MAPPING, source.nav))
    with progress_bar("pairs") as bar:
        bars = {task.rig: bar.add_task(task, total=len(part)) for task, part in parts if part is not None}

        def show_line(text: str) -> None:
            if bar.console.is_terminal:
                bar.console.print(printable(text), highlight=False, markup=False)

        outcome = replay_and_score(
            source, options, files, command_line(), page, progress=lambda rig: bar.advance(bars[rig]), say=show_line
        )
    try:
        present(outcome.score, None if files is None else str(files.report), None if files is None else files.page)
    finally:
        _report_files(outcome, files)
        if page is not None:
            page.scored(to_json(outcome.score), None if files is None else files.page)
    return outcome


def _report_files(outcome: ScoredReplay, files: ReplayFiles | None) -> None:
    """Print the remarks, the warning and the path of the report."""
    for remark in outcome.remarks:
        say(remark, err=True)
    if outcome.warning is not None:
        warn(outcome.warning)
    if files is None:
        propose_again("--out out", why="keeps report, estimate and cloud")
        return
    page = files.page if files.page.exists() else files.report
    if not page.exists():
        return  # the score could not be written
    say(f"report: {page}")
    propose_page(page)
