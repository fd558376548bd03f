"""`sfr convert`: any source to a ROS 2 bag or a data set folder."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import RemapOption, SourceArgument, naming, parse_remaps, progress_bar
from sfr_loc_map.cli.output import OverwriteOption, check_outputs, output_folder, say
from sfr_loc_map.errors import InputError


class Compression(StrEnum):
    """How chunks of a bag are compressed."""

    NONE = "none"
    ZSTD = "zstd"


@app.command(
    epilog=examples(
        "sfr convert data/ drive.mcap --jpeg-quality 90 --compression zstd",
        "sfr convert recording.mcap data/ --remap /cam0/image:=loc/left/image_rect",
        "sfr convert data/ truth.tum",
    )
)
def convert(
    source: SourceArgument,
    destination: Annotated[
        Path,
        typer.Argument(
            metavar="DST",
            help="*.mcap, *.db3, *.bag: a ROS 2 bag; *.csv, *.txt, *.tum: the true trajectory; else a folder.",
        ),
    ],
    remap: RemapOption = None,
    jpeg_quality: Annotated[
        int | None, typer.Option(min=1, max=100, metavar="Q", help="JPEG images (bags only).")
    ] = None,
    compression: Annotated[Compression, typer.Option(help="Of a bag's chunks (mcap only).")] = Compression.NONE,
    truth_grid: Annotated[
        float | None, typer.Option(metavar="M", help="Round true points to this power of two (bags only).")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Convert a data set folder, ROS 2 bag, KITTI or EuRoC sequence, or TUM trajectory to a bag or a folder."""
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.trajectory_file import load_trajectory
    from sfr_loc_map.pipeline.convert import ConvertOptions, convert_trajectory, is_trajectory
    from sfr_loc_map.pipeline.convert import convert as run

    if is_trajectory(destination):
        check_outputs(destination, overwrite=overwrite, inputs=(source,))
        room: AbstractContextManager[None] = nullcontext()
    else:
        room = output_folder(destination, overwrite=overwrite, inputs=(source,))
    if is_trajectory(source) and not source.is_dir():
        poses = load_trajectory(source)
        with room:
            say(f"{convert_trajectory(poses, destination)} poses: {destination}", err=True)
        return
    opened = open_source(source, parse_remaps(remap))
    if is_trajectory(destination):
        truth = opened.loc.ground_truth if opened.loc is not None else None
        if truth is None:
            raise InputError(f"'{source}' has no true trajectory to write as '{destination}'")
        say(f"{convert_trajectory(truth, destination)} poses: {destination}", err=True)
        return
    total = sum(len(part) for part in (opened.loc, opened.nav) if part is not None)
    options = ConvertOptions(jpeg_quality, compression is Compression.ZSTD, truth_grid)
    with room, naming(source), progress_bar("pairs") as bar:
        task = bar.add_task("converting", total=total)
        count = run(opened, destination, options, lambda done: bar.update(task, completed=done))
    say(f"{count} pairs: {destination}", err=True)
