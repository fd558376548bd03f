"""`sfr replay`: a source through the three nodes over topics, scored."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import (
    ConditionOption,
    ConfigOption,
    RemapOption,
    SourceArgument,
    StartOption,
    check_start,
    naming,
    parse_remaps,
    progress_bar,
    read_config,
    require_ros,
)
from sfr_loc_map.cli.convention import ApplyDiagnosisOption, ConventionOption
from sfr_loc_map.cli.external import (
    AnswersOption,
    AnswerTimeoutOption,
    CommandOption,
    ExternalOption,
    FramesOption,
    MethodOption,
    WatchOption,
    read_conversion,
    read_external,
)
from sfr_loc_map.cli.live import LiveOption, LivePortOption, live_beside
from sfr_loc_map.cli.output import OverwriteOption, check_outputs
from sfr_loc_map.cli.replay_result import check_answers, result_of, say_where
from sfr_loc_map.cli.score import LimitsOption, present
from sfr_loc_map.cli.verdict import LenientOption, conclude, read_limits
from sfr_loc_map.config import changed
from sfr_loc_map.errors import InterruptedRunError, OutputError
from sfr_loc_map.printable import printable

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import Source
    from sfr_loc_map.localisation.start_pose import StartPose
    from sfr_loc_map.metrics.limits import Limits
    from sfr_loc_map.metrics.score import Score
    from sfr_loc_map.nodes.replay.options import ReplayOptions
    from sfr_loc_map.pipeline.replay import ReplayFiles, ReplayResult
    from sfr_loc_map.pipeline.scoring import Correction


OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder for report, estimate, statistics and cloud.")
]
RateOption = Annotated[
    float,
    typer.Option(
        min=0.0, metavar="R", help="0: wait for the result of each pair; else multiple of the recorded speed."
    ),
]
LoopOption = Annotated[bool, typer.Option("--loop/--no-loop", help="Restart at the end, until q or Ctrl-C.")]
OffsetOption = Annotated[float, typer.Option(min=0.0, metavar="S", help="Part of the source that is left out.")]
PausedOption = Annotated[bool, typer.Option("--start-paused", help="Wait for space, s or ~/resume.")]


HELP = """Play a source to the three nodes over topics, record what they answer, score it.

Keys, where standard input is a terminal: space pauses and resumes, s or the right arrow plays one pair, the left
arrow goes 5 s back and f 5 s on, up and down change the rate, l the loop, q ends and scores. The same as services
of /sfr_player: ~/pause, ~/resume, ~/toggle_paused, ~/play_next, ~/stop, ~/set_loop; parameters rate and seek_s.
The end and each jump begin a new run; the last one that was played to its end is scored, else the last one. Others
that a jump or a signal cut short are kept in DIR/run_1, DIR/run_2. Ctrl-C ends as q does, exit 130.

With --external a node of anyone takes the place of ours: it subscribes to the images of its task and publishes
nav_msgs/Odometry or sensor_msgs/PointCloud2 with the stamp of each pair. In lock step each answer is waited for
(--answer-timeout); its crash or silence is a finding, and the replay goes on. See docs/candidates.md.
"""


@app.command(
    help=HELP,
    epilog=examples(
        "sfr replay data/ --start truth --out out/",
        "sfr replay drive.mcap --rate 1 --loop --out out/ --overwrite",
        "sfr replay data/ --limits limits.yaml --condition distance=10",
        "sfr replay data/ --external localisation --command 'python3 my_node.py' --convention frame=left_optical",
    ),
)
def replay(
    source: SourceArgument,
    out: OutOption = None,
    rate: RateOption = 0.0,
    loop: LoopOption = False,
    start_offset: OffsetOption = 0.0,
    start_paused: PausedOption = False,
    limits: LimitsOption = None,
    condition: ConditionOption = None,
    start: StartOption = "identity",
    config: ConfigOption = None,
    remap: RemapOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
    live: LiveOption = False,
    live_port: LivePortOption = 8080,
    external: ExternalOption = None,
    method: MethodOption = "sfr",
    command: CommandOption = "",
    watch: WatchOption = "",
    answers: AnswersOption = "",
    frames: FramesOption = "",
    answer_timeout: AnswerTimeoutOption = 5.0,
    convention: ConventionOption = None,
    apply_diagnosis: ApplyDiagnosisOption = False,
) -> None:
    """Play a source to the nodes over topics, record what they answer, score it."""
    with live_beside(live, live_port, isolated=True) as page:
        from sfr_loc_map.io.registry import open_source

        opened = open_source(source, remaps := parse_remaps(remap))
        parsed_limits, asked = read_limits(limits, condition)
        correction = read_conversion(convention, apply_diagnosis)
        require_ros("replay")
        from sfr_loc_map.nodes.replay.options import ReplayOptions

        given = command, watch, answers, frames
        options = ReplayOptions(
            **_settings(config, limits, condition),
            start=_first_pose(opened, check_start(start), start_offset),
            rate=rate,
            offset_s=start_offset,
            paused=start_paused,
            loop=loop,
            remap=remaps,
            page=page,
            external=read_external(opened, (external, method), given, answer_timeout, correction),
        )
        score = _replay_and_score((source, opened), options, correction, parsed_limits, (out, overwrite))
        conclude(score, asked, lenient=lenient or not (limits or condition))  # of what nobody named it warns


def _settings(config: Path | None, limits: Path | None, condition: list[str] | None) -> dict[str, Any]:
    """Return the options of a replay that a parameter file gives, and those of its score.

    Raises:
        ConfigError: If a value in it is not valid.
    """
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.metrics.config import score_config
    from sfr_loc_map.nodes.replay.options import is_ros_parameter_file

    return {
        "localisation": read_config(LocalisationConfig, config, "localisation"),
        "mapping": read_config(MappingConfig, config, "mapping"),
        "parameter_file": config if config is not None and is_ros_parameter_file(config) else None,
        "score": score_config(condition, {}),
        "limits": limits,
    }


def _first_pose(source: Source, start: str, offset_s: float) -> Callable[[float], StartPose | None]:
    """Return what gives the pose at the first pair after so many seconds, None for the identity.

    Raises:
        InputError: If there is none after `offset_s`.
    """
    from sfr_loc_map.pipeline.offline import start_pose

    def pose(offset_s: float) -> StartPose | None:
        return None if source.loc is None or start == "identity" else start_pose(source.loc, start, offset_s)

    with naming(source.path):
        pose(offset_s)
    return pose


def _replay_and_score(
    opened: tuple[Path, Source],
    options: ReplayOptions,
    correction: Correction,
    limits: Limits | None,
    output: tuple[Path | None, bool],
) -> Score:
    """Replay, write the outputs to a folder if one is given, print the score.

    Args:
        opened: The source, and the same opened.
        options: How it is replayed.
        correction: How the poses of an external node are converted.
        limits: Limits to judge by.
        output: Folder for the outputs, and whether they may replace others.

    Raises:
        InterruptedRunError: If the user ended the replay; what was finished is written and printed.
    """
    import tempfile

    from sfr_loc_map.pipeline.replay import ReplayFiles, save_replay, score_replay

    (path, source), (out, overwrite) = opened, output
    with tempfile.TemporaryDirectory(prefix="sfr-replay-") as scratch:
        files = ReplayFiles(out or Path(scratch))
        with _room_for(files, overwrite=overwrite):
            with naming(path):
                result, interruption = _run(source, options, correction)
                result = result.finished(source, options.score)
            for file in files.all:
                file.unlink(missing_ok=True)  # of an earlier run, which may have written more of them
            save_replay(result, files)
            settings = changed(options.localisation, "localisation.") | changed(options.mapping, "mapping.")
            score = score_replay(source, result, files, options.score, limits, settings)
            try:
                present(score, None if out is None else str(files.report), None if out is None else files.page)
            finally:
                say_where(path, result, files, out)
    if interruption:
        raise InterruptedRunError(interruption)
    return score


@contextmanager
def _room_for(files: ReplayFiles, *, overwrite: bool) -> Iterator[None]:
    """Make the folder of the outputs; take it away again if nothing came to be in it."""
    out = files.folder
    made = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder '{out}': {error.strerror}; choose another --out") from error
    try:
        check_outputs(*files.all, overwrite=overwrite)
        yield
    finally:
        if made and not any(out.iterdir()):
            out.rmdir()


def _run(source: Source, options: ReplayOptions, correction: Correction) -> tuple[ReplayResult, str]:
    """Replay with progress bars and return what came out, and what was finished if the user ended it."""
    from sfr_loc_map.nodes.replay.replay import AGAIN
    from sfr_loc_map.nodes.replay.replay import replay as run

    totals = {name: len(part) for name, part in (("loc", source.loc), ("nav", source.nav)) if part is not None}
    labels = {"loc": "localisation", "nav": "mapping"}
    with progress_bar("pairs") as bar:
        tasks = {name: bar.add_task(labels[name], total=total) for name, total in totals.items()}

        def show_line(text: str) -> None:
            again = text.startswith(AGAIN)
            if again or bar.console.is_terminal:
                bar.console.print(printable(text), highlight=False, markup=False)
            if again:
                for name, task in tasks.items():
                    bar.reset(task, total=totals[name])

        results = run(source, options, lambda task: bar.advance(tasks[task]), show_line)
    if results.interrupted and not results.count:
        raise KeyboardInterrupt
    check_answers(results, options)
    result = result_of(results, correction)
    count = f"{len(results.published)} of {sum(totals.values())} pairs"
    return result, f"interrupted: {count} were played, and scored" if results.interrupted else ""
