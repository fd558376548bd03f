"""`sfr localise`: a drive to a trajectory, offline."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app
from sfr_loc_map.cli.common import (
    ConfigOption,
    RemapOption,
    SourceArgument,
    StartOption,
    check_start,
    naming,
    open_drive,
    progress_bar,
    read_config,
)
from sfr_loc_map.cli.output import check_output


@app.command()
def localise(
    source: SourceArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="Trajectory: .csv, or TUM for .txt and .tum.")],
    stats: Annotated[Path | None, typer.Option(help="CSV with a row for each call: time, memory, state, ...")] = None,
    video: Annotated[Path | None, typer.Option(help="Feature-track video, .avi or .mp4.")] = None,
    start: StartOption = "identity",
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Estimate the trajectory of a drive, with the same code as the node."""
    from sfr_loc_map.io.trajectory_file import TUM_SUFFIXES, save_trajectory
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.pipeline.offline import localise as run
    from sfr_loc_map.pipeline.offline import no_observer, save_stats, start_pose, trajectory_of
    from sfr_loc_map.pipeline.video import track_video

    check_start(start)
    check_output(output, (".csv", *TUM_SUFFIXES))
    check_output(stats)
    parameters = read_config(LocalisationConfig, config, "localisation")
    sequence = open_drive(source, remap)
    with naming(source):
        first_pose = start_pose(sequence, start)
    estimates, records = [], []
    video_writer = nullcontext(no_observer) if video is None else track_video(video, sequence.rig)
    with naming(source), video_writer as watch, progress_bar("pairs") as bar:
        task = bar.add_task("localising", total=len(sequence))
        for estimate, record in run(sequence, parameters, first_pose, watch):
            estimates.append(estimate)
            records.append(record)
            bar.advance(task)
    save_trajectory(output, trajectory_of(estimates))
    if stats is not None:
        save_stats(stats, records)
    lost = sum(record.state == "lost" for record in records)
    typer.echo(f"{len(estimates)} poses, {lost} lost: {output}", err=True)
