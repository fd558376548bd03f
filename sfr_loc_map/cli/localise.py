"""`sfr localise`: a drive to a trajectory, offline."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import (
    CallTimeoutOption,
    ConfigOption,
    MemoryLimitOption,
    MethodOption,
    RemapOption,
    SourceArgument,
    StartOption,
    check_start,
    naming,
    open_drive,
    progress_bar,
    read_config,
)
from sfr_loc_map.cli.method import OURS, conclude_findings, method_limits, method_of
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import OverwriteOption, check_outputs, check_suffix, say, warn
from sfr_loc_map.errors import ConfigError, InterruptedRunError

if TYPE_CHECKING:
    from sfr_loc_map.geometry.transform import Transform
    from sfr_loc_map.io.sequence import LocSequence
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.localisation.estimate import PoseEstimate
    from sfr_loc_map.localisation.start_pose import StartPose
    from sfr_loc_map.methods.method import Method, MethodLimits
    from sfr_loc_map.metrics.method_record import MethodRecord
    from sfr_loc_map.pipeline.call_record import CallRecord

R = TypeVar("R")
OutputOption = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="T.csv", help="Trajectory: *.csv, *.txt or *.tum, *.kitti, *.euroc.csv."),
]


@app.command(
    epilog=examples(
        "sfr localise data/ -o estimate.csv --stats stats.csv --start truth",
        "sfr localise drive.mcap -o estimate.tum --config config/localisation.yaml",
        "sfr localise data/ -o estimate.csv --video tracks.avi",
        "sfr localise data/ -o other.csv --stats other.stats.csv --method lib:build/libmine.so",
    )
)
def localise(
    source: SourceArgument,
    output: OutputOption,
    stats: Annotated[
        Path | None, typer.Option(metavar="S.csv", help="A row for each call: time, memory, state, ...")
    ] = None,
    video: Annotated[Path | None, typer.Option(metavar="V.avi", help="Feature-track video, .avi or .mp4.")] = None,
    start: StartOption = "identity",
    method: MethodOption = OURS,
    call_timeout: CallTimeoutOption = 120.0,
    memory_limit: MemoryLimitOption = 4000,
    config: ConfigOption = None,
    remap: RemapOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Estimate the trajectory of a drive, with the same code as the node, or by another method."""
    from sfr_loc_map.io.trajectory_formats import OUTPUT_SUFFIXES, files_written, write_trajectory_file
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.methods.method import MethodTask
    from sfr_loc_map.methods.registry import record_of_ours
    from sfr_loc_map.pipeline.offline import save_stats, start_pose, trajectory_of
    from sfr_loc_map.pipeline.tracking_summary import states_text, tracking_warning

    check_start(start)
    check_suffix(output, OUTPUT_SUFFIXES)
    check_outputs(*files_written(output), stats, video, overwrite=overwrite, inputs=(source,))
    foreign = None if method == OURS else method_of(method, MethodTask.LOCALISE, config)
    if foreign is not None and video is not None:
        raise ConfigError(f"'--video' shows the tracks of our localiser: leave it out with --method {method}")
    parameters = read_config(LocalisationConfig, config if foreign is None else None, "localisation")
    sequence = open_drive(source, remap)
    with naming(source):
        first_pose = start_pose(sequence, start)
        if foreign is None:
            done, about = _run(sequence, parameters, first_pose, video), record_of_ours(MethodTask.LOCALISE)
        else:
            limits = method_limits(call_timeout, memory_limit)
            done, about = _run_foreign(sequence, foreign, first_pose.T_ds_rb, limits)
    records = [record for _, record in done]
    write_trajectory_file(output, trajectory_of(estimate for estimate, _ in done))
    if stats is not None:
        save_stats(stats, records, about)
    say(f"{len(done)} poses, {states_text(records)}: {output}", err=True)
    _propose(output, source if sequence.ground_truth is not None else "TRUTH", stats)
    text = tracking_warning(records, source)
    if text is not None:
        warn(text)
    if len(done) < len(sequence):
        raise InterruptedRunError(f"interrupted: {len(done)} of {len(sequence)} pairs were localised, and written")
    conclude_findings(about, records)


def _propose(output: Path, truth: Path | str, stats: Path | None) -> None:
    propose("sfr", "score", output, truth, *(("--stats", stats) if stats is not None else ()), why="against the truth")


def _run(
    sequence: LocSequence, parameters: LocalisationConfig, first_pose: StartPose, video: Path | None
) -> list[tuple[PoseEstimate, CallRecord]]:
    """Localise a drive; interrupted, return what was finished."""
    from sfr_loc_map.pipeline.offline import localise as run
    from sfr_loc_map.pipeline.offline import no_observer
    from sfr_loc_map.pipeline.video import track_video

    video_writer = nullcontext(no_observer) if video is None else track_video(video, sequence.rig)
    with video_writer as watch:
        return _finished(run(sequence, parameters, first_pose, watch), len(sequence))


def _run_foreign(
    sequence: LocSequence, method: Method, first_pose: Transform, limits: MethodLimits
) -> tuple[list[tuple[PoseEstimate, CallRecord]], MethodRecord]:
    """Localise a drive by a method under test, and return whose the estimates are."""
    from sfr_loc_map.pipeline.candidate import localise_with

    done = _finished(localise_with(method, sequence, first_pose, limits), len(sequence))
    return [(estimate, record) for estimate, record, _ in done], done[-1][2]


def _finished(results: Iterable[R], total: int) -> list[R]:
    """Return results while a bar shows how many there are; interrupted, those that were finished."""
    done: list[R] = []
    with progress_bar("pairs") as bar:
        task = bar.add_task("localising", total=total)
        try:
            for result in results:
                done.append(result)
                bar.advance(task)
        except KeyboardInterrupt:
            if not done:
                raise
    return done
