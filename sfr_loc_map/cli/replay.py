"""`sfr replay`: a source through the three nodes over topics, scored."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from sfr_loc_map.cli.live import LiveOption, LivePortOption, page_arguments
from sfr_loc_map.cli.output import OverwriteOption, check_outputs, say, warn
from sfr_loc_map.cli.score import LimitsOption, present, score_config
from sfr_loc_map.cli.verdict import LenientOption, conclude, read_limits
from sfr_loc_map.errors import InterruptedRunError, NodeError, OutputError
from sfr_loc_map.printable import printable

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import Source
    from sfr_loc_map.localisation.start_pose import StartPose
    from sfr_loc_map.metrics.score import Score
    from sfr_loc_map.metrics.verdicts.limits import Limits
    from sfr_loc_map.nodes.replay.options import ReplayOptions
    from sfr_loc_map.nodes.replay.results import ReplayResults
    from sfr_loc_map.pipeline.replay import ReplayFiles, ReplayResult


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


@app.command(
    epilog=examples(
        "sfr replay data/ --start truth --out out/",
        "sfr replay drive.mcap --rate 1 --loop --out out/ --overwrite",
        "sfr replay data/ --limits limits.yaml --condition distance=10",
    )
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
) -> None:
    """Play a source to the three nodes over topics, record what they answer, score it.

    Keys, where standard input is a terminal: space pauses and resumes, s or the right arrow plays one pair, the left
    arrow goes 5 s back and f 5 s on, up and down change the rate, l the loop, q ends and scores. The same as services
    of /sfr_player: ~/pause, ~/resume, ~/toggle_paused, ~/play_next, ~/stop, ~/set_loop; parameters rate and seek_s.
    The end and each jump begin a new run; the last one that was played to its end is scored, else the last one. Others
    that a jump or a signal cut short are kept in DIR/run_1, DIR/run_2. Ctrl-C ends as q does, exit 130.
    """
    from sfr_loc_map.io.registry import open_source

    opened = open_source(source, remaps := parse_remaps(remap))
    parsed_limits, asked = read_limits(limits, condition)
    require_ros("replay")
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.nodes.replay.options import ReplayOptions, is_ros_parameter_file

    options = ReplayOptions(
        localisation=read_config(LocalisationConfig, config, "localisation"),
        mapping=read_config(MappingConfig, config, "mapping"),
        score=score_config(condition, {}),
        limits=limits,
        start=_first_pose(opened, check_start(start), start_offset),
        rate=rate,
        offset_s=start_offset,
        paused=start_paused,
        loop=loop,
        remap=remaps,
        parameter_file=config if config is not None and is_ros_parameter_file(config) else None,
        live=page_arguments(live, live_port),
    )
    score = _replay_and_score(source, opened, options, parsed_limits, (out, overwrite))
    conclude(score, asked, lenient=lenient or not (limits or condition))  # of what nobody named it warns


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
    path: Path, source: Source, options: ReplayOptions, limits: Limits | None, output: tuple[Path | None, bool]
) -> Score:
    """Replay, write the outputs to a folder if one is given, print the score.

    Args:
        path: The source.
        source: The source, opened.
        options: How it is replayed.
        limits: Limits to judge by.
        output: Folder for the outputs, and whether they may replace others.

    Raises:
        InterruptedRunError: If the user ended the replay; what was finished is written and printed.
    """
    import tempfile

    from sfr_loc_map.pipeline.replay import ReplayFiles, save_replay, score_replay

    out, overwrite = output
    with tempfile.TemporaryDirectory(prefix="sfr-replay-") as scratch:
        files = ReplayFiles(out or Path(scratch))
        with _room_for(files, overwrite=overwrite):
            with naming(path):
                result, interruption = _run(source, options)
            for file in files.all:
                file.unlink(missing_ok=True)  # of an earlier run, which may have written more of them
            save_replay(result, files)
            score = score_replay(source, result, files, options.score, limits)
            try:
                present(score, None if out is None else str(files.report), None if out is None else files.page)
            finally:
                _say_where(path, result, files, out)
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


def _run(source: Source, options: ReplayOptions) -> tuple[ReplayResult, str]:
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
    played = len(results.published_stamps("loc"))
    missing = played - len(results.rows)
    if missing > 0:
        say(f"{missing} of {played} pairs have no odometry: the nodes could not keep up", err=True)
    if results.published_stamps("nav") and not results.clouds:
        raise NodeError("mapping_node gave no cloud: play slower (--rate) or in lock step (--rate 0)")
    result = _result_of(results)
    count = f"{len(results.published)} of {sum(totals.values())} pairs"
    return result, f"interrupted: {count} were played, and scored" if results.interrupted else ""


def _result_of(results: ReplayResults) -> ReplayResult:
    """Return what the nodes published as files and score have it."""
    from sfr_loc_map.pipeline.replay import ReplayResult

    cloud, mapped_ns = results.last_map()
    cut_short = tuple(_result_of(run) for run in results.cut_short)
    return ReplayResult(results.trajectory, cloud, results.records, results.report, mapped_ns, cut_short)


def _say_where(source: Path, result: ReplayResult, files: ReplayFiles, out: Path | None) -> None:
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
