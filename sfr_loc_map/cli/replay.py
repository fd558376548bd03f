"""`sfr replay`: a source through the three nodes over topics, scored."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import app
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
from sfr_loc_map.cli.output import check_output
from sfr_loc_map.cli.score import LimitsOption, present, score_config
from sfr_loc_map.errors import NodeError, OutputError

if TYPE_CHECKING:
    from sfr_loc_map.geometry.transform import Transform
    from sfr_loc_map.io.sequence import Source
    from sfr_loc_map.metrics.verdicts.limits import Limits
    from sfr_loc_map.nodes.replay.options import ReplayOptions
    from sfr_loc_map.pipeline.replay import ReplayFiles, ReplayResult


OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder for report, estimate, statistics and cloud.")
]
RateOption = Annotated[
    float, typer.Option(min=0.0, help="0: wait for the result of each pair; else multiple of the recorded speed.")
]
LoopOption = Annotated[bool, typer.Option("--loop/--no-loop", help="Restart at the end, until q or Ctrl-C.")]
OffsetOption = Annotated[float, typer.Option(min=0.0, help="Seconds of the source that are left out.")]
PausedOption = Annotated[bool, typer.Option("--start-paused", help="Wait for space, s or ~/resume.")]


@app.command()
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
) -> None:
    """Play a source to the three nodes over topics, record what they answer, score it.

    Keys, where standard input is a terminal: space pauses and resumes, s or the right arrow plays one pair, the left
    arrow goes 5 s back and f 5 s on, up and down change the rate, l the loop, q ends and scores. The same as services
    of /sfr_player: ~/pause, ~/resume, ~/toggle_paused, ~/play_next, ~/stop, ~/set_loop; parameters rate and seek_s.
    The last run is scored: each jump begins a new one.
    """
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.metrics.verdicts.limits import load_limits

    check_start(start)
    remaps = parse_remaps(remap)
    opened = open_source(source, remaps)
    parsed_limits = load_limits(limits) if limits is not None else None
    require_ros("replay")
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.nodes.replay.options import ReplayOptions, is_ros_parameter_file

    first_pose = _first_pose(opened, start)
    with naming(source):
        first_pose(start_offset)
    options = ReplayOptions(
        localisation=read_config(LocalisationConfig, config, "localisation"),
        mapping=read_config(MappingConfig, config, "mapping"),
        score=score_config(condition, {}),
        limits=limits,
        start=first_pose,
        rate=rate,
        offset_s=start_offset,
        paused=start_paused,
        loop=loop,
        remap=remaps,
        parameter_file=config if config is not None and is_ros_parameter_file(config) else None,
    )
    _replay_and_score(source, opened, options, parsed_limits, out)


def _first_pose(source: Source, start: str) -> Callable[[float], Transform | None]:
    """Return what gives the pose at the first pair after so many seconds, None for the identity."""
    from sfr_loc_map.pipeline.offline import start_pose

    loc = source.loc
    return lambda offset_s: None if loc is None or start == "identity" else start_pose(loc, start, offset_s)


def _replay_and_score(
    path: Path, source: Source, options: ReplayOptions, limits: Limits | None, out: Path | None
) -> None:
    """Replay, write the outputs to a folder if one is given, print the score."""
    import tempfile

    from sfr_loc_map.pipeline.replay import ReplayFiles, save_replay, score_replay

    with tempfile.TemporaryDirectory(prefix="sfr-replay-") as scratch, _folder(out or Path(scratch)) as folder:
        files = ReplayFiles(folder)
        with naming(path):
            result = _run(source, options)
        save_replay(result, files)
        score = score_replay(source, result, files, options.score, limits)
        try:
            present(score, None if out is None else str(files.report), None if out is None else files.page)
        finally:
            _say_where(result, files, out)


@contextmanager
def _folder(out: Path) -> Iterator[Path]:
    """Make the folder of the outputs; take it away again if nothing came to be in it."""
    made = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder '{out}': {error.strerror}; choose another --out") from error
    try:
        check_output(out / "report.json")
        yield out
    finally:
        if made and not any(out.iterdir()):
            out.rmdir()


def _run(source: Source, options: ReplayOptions) -> ReplayResult:
    """Replay with progress bars and return what came out."""
    from sfr_loc_map.nodes.replay.replay import AGAIN
    from sfr_loc_map.nodes.replay.replay import replay as run
    from sfr_loc_map.pipeline.replay import ReplayResult

    totals = {name: len(part) for name, part in (("loc", source.loc), ("nav", source.nav)) if part is not None}
    labels = {"loc": "localisation", "nav": "mapping"}
    with progress_bar("pairs") as bar:
        tasks = {name: bar.add_task(labels[name], total=total) for name, total in totals.items()}

        def say(text: str) -> None:
            again = text.startswith(AGAIN)
            if again or bar.console.is_terminal:
                bar.console.print(text, highlight=False)
            if again:
                for name, task in tasks.items():
                    bar.reset(task, total=totals[name])

        results = run(source, options, lambda task: bar.advance(tasks[task]), say)
    played = len(results.published_stamps("loc"))
    missing = played - len(results.rows)
    if missing > 0:
        typer.echo(f"{missing} of {played} pairs have no odometry: the nodes could not keep up", err=True)
    if results.published_stamps("nav") and not results.clouds:
        raise NodeError("mapping_node gave no cloud: play slower (--rate) or in lock step (--rate 0)")
    cloud, mapped_ns = results.last_map()
    return ReplayResult(results.trajectory, cloud, results.records, results.report, mapped_ns)


def _say_where(result: ReplayResult, files: ReplayFiles, out: Path | None) -> None:
    lost = sum(record.state == "lost" for record in result.records)
    typer.echo(f"{len(result.estimate)} poses, {lost} lost", err=True)
    if out is not None:
        page = files.page if files.page.exists() else files.report
        typer.echo(f"report: {page}")
