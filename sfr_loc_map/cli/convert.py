"""`sfr convert`: any source to a bag, a folder or the layout of another data set; a cloud to others."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import RemapOption, SourceArgument, naming, parse_remaps, progress_bar
from sfr_loc_map.cli.convert_cloud import convert_cloud, is_cloud
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import OverwriteOption, check_outputs, output_folder, say, warn
from sfr_loc_map.errors import ConfigError, InputError

if TYPE_CHECKING:
    from sfr_loc_map.geometry.trajectory import Trajectory
    from sfr_loc_map.pipeline.convert import ConvertOptions


class Compression(StrEnum):
    """How chunks of a bag are compressed."""

    NONE = "none"
    ZSTD = "zstd"


class To(StrEnum):
    """Layouts of other data sets."""

    KITTI = "kitti"
    EUROC = "euroc"


@dataclass(frozen=True, slots=True)
class _Job:
    """What is converted, and where to."""

    source: Path
    destination: Path
    remap: list[str] | None
    overwrite: bool


@app.command(
    epilog=examples(
        "sfr convert data/ drive.mcap --jpeg-quality 90 --compression zstd",
        "sfr convert recording.mcap data/ --remap /cam0/image:=loc/left/image_rect",
        "sfr convert data/ sequence/ --to kitti",
        "sfr convert data/ truth.tum",
        "sfr convert cloud.ply site.tif --cell 0.05",
    )
)
def convert(
    source: SourceArgument,
    destination: Annotated[
        Path,
        typer.Argument(
            metavar="DST",
            help="*.mcap, *.db3, *.bag: a ROS 2 bag; *.csv, *.txt, *.tum, *.kitti, *.euroc.csv: the true trajectory; "
            "else a folder. Of a cloud: *.ply, *.pcd, *.npz, *.las, *.laz, or its elevation model: *.tif, *.dem.npz, "
            "*.png, *.html.",
        ),
    ],
    to: Annotated[
        To | None, typer.Option("--to", help="Write the drive in the layout of KITTI odometry or EuRoC (ASL).")
    ] = None,
    remap: RemapOption = None,
    jpeg_quality: Annotated[
        int | None, typer.Option(min=1, max=100, metavar="Q", help="JPEG images (bags only).")
    ] = None,
    compression: Annotated[Compression, typer.Option(help="Of a bag's chunks (mcap only).")] = Compression.NONE,
    truth_grid: Annotated[
        float | None, typer.Option(metavar="M", help="Round true points to this power of two (bags only).")
    ] = None,
    cell: Annotated[
        float | None, typer.Option(metavar="M", help="Side of the cells of an elevation model, 0.1 m unless given.")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Convert a source to a bag, a folder or a layout of others; a trajectory; a cloud, also to an elevation model.

    Sources are data set folders, ROS 1 and ROS 2 bags, sequences of KITTI, EuRoC, MADMAX, Katwijk and LuSNAR.
    """
    from sfr_loc_map.pipeline.convert import ConvertOptions, Layout, holds_trajectory, is_trajectory

    job = _Job(source, destination, remap, overwrite)
    layout = None if to is None else Layout(to.value)
    options = ConvertOptions(jpeg_quality, compression is Compression.ZSTD, truth_grid, layout)
    if cell is not None and not is_cloud(source):
        raise ConfigError(f"'--cell' is of the elevation model of a cloud: '{source}' is not a file of points")
    if is_cloud(source):
        if options != ConvertOptions() or remap:
            raise ConfigError(f"'{source}' is a cloud: of the options '--cell' and '--overwrite' alone are for clouds")
        convert_cloud(source, destination, cell, overwrite=overwrite)
    elif layout is None and is_trajectory(destination):
        _to_trajectory(job)
    elif holds_trajectory(source):
        if layout is not None:
            raise ConfigError(f"'--to {layout}' writes images: '{source}' is a trajectory alone")
        _from_trajectory(job)
    else:
        _to_data_set(job, options)


def _to_trajectory(job: _Job) -> None:
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.trajectory_formats import files_written
    from sfr_loc_map.pipeline.convert import convert_trajectory, holds_trajectory

    check_outputs(*files_written(job.destination), overwrite=job.overwrite, inputs=(job.source,))
    if holds_trajectory(job.source):
        poses = _read_trajectory(job.source)
    else:
        opened = open_source(job.source, parse_remaps(job.remap))
        truth = opened.loc.ground_truth if opened.loc is not None else None
        if truth is None:
            raise InputError(f"'{job.source}' has no true trajectory to write as '{job.destination}'")
        poses = truth
    say(f"{convert_trajectory(poses, job.destination)} poses: {job.destination}", err=True)
    propose("sfr", "score", "EST", job.destination, why="an estimate against these poses")


def _from_trajectory(job: _Job) -> None:
    from sfr_loc_map.pipeline.convert import convert_trajectory

    with output_folder(job.destination, overwrite=job.overwrite, inputs=(job.source,)):
        poses = _read_trajectory(job.source)
        say(f"{convert_trajectory(poses, job.destination)} poses: {job.destination}", err=True)


def _read_trajectory(path: Path) -> Trajectory:
    """Read a trajectory and say which foreign format was found."""
    from sfr_loc_map.io.trajectory_formats import FOREIGN, read_trajectory_file

    read = read_trajectory_file(path)
    if read.format in FOREIGN:
        say(read.text, err=True)
    return read.trajectory


def _to_data_set(job: _Job, options: ConvertOptions) -> None:
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.pipeline.convert import convert as run

    room = output_folder(job.destination, overwrite=job.overwrite, inputs=(job.source,))
    opened = open_source(job.source, parse_remaps(job.remap))
    if options.layout is not None and opened.loc is not None and opened.nav is not None:
        warn(f"the mapping pairs of '{job.source}' are left out: the layout of {options.layout} has none")
    parts = (opened.loc,) if options.layout is not None else (opened.loc, opened.nav)
    total = sum(len(part) for part in parts if part is not None)
    with room, naming(job.source), progress_bar("pairs") as bar:
        task = bar.add_task("converting", total=total)
        count = run(opened, job.destination, options, lambda done: bar.update(task, completed=done))
    say(f"{count} pairs: {job.destination}", err=True)
    propose("sfr", "doctor", job.destination, why="is it complete")
