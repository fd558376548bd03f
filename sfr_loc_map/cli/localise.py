"""`sfr localise`: estimate the trajectory of a drive, offline."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Context, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import (
    CallTimeoutOption,
    ConfigOption,
    MemoryLimitOption,
    MethodOption,
    OverwriteOption,
    RemapOption,
    SourceArgument,
    StartOption,
    announced_config,
    given_words,
    method_under_test,
)
from sfr_loc_map.cli.output import check_suffix, claim_outputs, pairs_progress, say, secondary_output, warn
from sfr_loc_map.cli.verdict import conclude_findings
from sfr_loc_map.errors import InterruptedRunError, naming
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.signals import hold
from sfr_loc_map.suite_names import OURS, Task

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import LocSequence
    from sfr_loc_map.localisation.estimate import StartPose
    from sfr_loc_map.runs.localiser_run import DriveRun
    from sfr_loc_map.runs.track_video import FrameObserver
    from sfr_loc_map.runs.under_test import UnderTest


@app.command(
    epilog=examples(
        "sfr localise data/ -o estimate.csv --stats stats.csv --start truth",
        "sfr localise drive.mcap -o estimate.tum --config config/localisation.yaml",
        "sfr localise data/ -o estimate.csv --video tracks.avi",
        "sfr localise data/ -o other.csv --stats other.stats.csv --method lib:build/libmine.so",
    )
)
def localise(
    context: Context,
    source: SourceArgument,
    output: Annotated[
        Path, Option("-o", "--output", metavar="T.csv", help="Trajectory: *.csv, *.txt or *.tum, *.kitti, *.euroc.csv.")
    ],
    stats: Annotated[
        Path | None, Option(metavar="S.csv", help="One row per call: time, state, ...; default: T.stats.csv.")
    ] = None,
    video: Annotated[Path | None, Option(metavar="V.avi", help="Feature-track video, .avi or .mp4.")] = None,
    start: StartOption = "identity",
    config: ConfigOption = None,
    remap: RemapOption = None,
    overwrite: OverwriteOption = False,
    method: MethodOption = OURS,
    call_timeout: CallTimeoutOption = 120.0,
    memory_limit: MemoryLimitOption = 4000,
) -> None:
    """Estimate the trajectory of a drive with the code of the localisation node, or with another method."""
    from sfr_loc_map.calls.call_files import save_stats, stats_beside
    from sfr_loc_map.calls.call_record import states_text, tracking_warning
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.sequence import drive_of
    from sfr_loc_map.io.tables.trajectory_writer import FILE_SUFFIXES, files_written, save_trajectory
    from sfr_loc_map.runs.drive_start import start_pose, unstamped_start_warning
    from sfr_loc_map.runs.track_video import track_video

    check_suffix(output, FILE_SUFFIXES)
    stats = stats_beside(output) if stats is None else stats
    source_config = announced_config(source, config if method == OURS else None, remap)
    inputs = (source, source_config.configuration.path, config)
    claim_outputs(*files_written(output), stats, video, inputs=inputs, overwrite=overwrite)
    opened = open_source(source, source_config)
    under_test = method_under_test(context, method, Task.LOCALISATION, opened, config, call_timeout, memory_limit)
    parameters = source_config.configuration.build(LocalisationConfig, "localisation")
    sequence = drive_of(opened)
    with ExitStack() as film, naming(source):
        first_pose = start_pose(sequence, start)
        if under_test is not None and (text := unstamped_start_warning(first_pose, sequence)) is not None:
            warn(text)
        truth = source if sequence.ground_truth is not None else "TRUTH"
        watch = None if video is None else film.enter_context(track_video(video, sequence.rig))
        done = _localised(sequence, under_test or parameters, first_pose, watch)
        save_trajectory(output, done.trajectory)
        with secondary_output():
            film.close()
    with secondary_output():
        save_stats(stats, done.records, {Task.LOCALISATION: done.method}, done.trajectory)
    say(f"{len(done.steps)} poses, {states_text(done.records)}: {output}", err=True)
    again = given_words(context, "stats", *(("config",) if under_test is None else ()))
    propose("sfr", "score", output, truth, *again, why="against the truth")
    if (text := tracking_warning(done.records, source, is_ours=under_test is None)) is not None:
        warn(text)
    count = len(done.steps)
    if count < len(sequence):
        raise InterruptedRunError(f"interrupted: {count} of {len(sequence)} pairs were localised and written")
    conclude_findings(done.method, done.records)


def _localised(
    sequence: LocSequence, method: LocalisationConfig | UnderTest, start: StartPose, watch: FrameObserver | None
) -> DriveRun:
    """Localise a drive with a progress bar, and return the run; after an interruption, return the finished pairs."""
    from sfr_loc_map.runs.localiser_run import run_localiser

    with pairs_progress("localising", len(sequence)) as progress:
        try:
            return run_localiser(sequence, method, start, watch, progress, keeps_finished=True)
        finally:
            hold()
