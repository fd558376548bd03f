"""`sfr convert`: convert a source to a bag, a folder or another data set layout; or convert a trajectory or a cloud."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Context, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import (
    ColumnsOption,
    ConfigOption,
    OverwriteOption,
    RemapOption,
    SourceArgument,
    announced_config,
    columns_of,
    files_read,
    open_as,
    parse_remaps,
    refuse_given,
)
from sfr_loc_map.cli.output import check_outputs, check_suffix, output_folder, progress_bar, say, warn
from sfr_loc_map.errors import ConfigError, naming

PAIRS = ".sfrp"  #: Suffix of a file of pairs for a target board.


@app.command(
    epilog=examples(
        "sfr convert data/ drive.mcap --jpeg-quality 90 --compression zstd",
        "sfr convert recording.mcap data/ --remap /cam0/image:=loc/left/image_rect",
        "sfr convert data/ sequence/ --to kitti",
        "sfr convert data/ truth.tum",
        "sfr convert cloud.ply cloud.npz",
    )
)
def convert(
    context: Context,
    source: SourceArgument,
    destination: Annotated[
        Path,
        Argument(
            metavar="DST",
            help="*.mcap, *.db3, *.bag: a ROS 2 bag; *.sfrp: pairs for a target board; *.csv, *.txt, *.tum, *.kitti, "
            "*.euroc.csv: the true trajectory; otherwise a folder. For a cloud: *.ply, *.pcd, *.npz.",
        ),
    ],
    to: Annotated[
        Literal["kitti", "euroc"] | None, Option(help="Write the drive in the layout of KITTI odometry or EuRoC (ASL).")
    ] = None,
    remap: RemapOption = None,
    columns: ColumnsOption = None,
    config: ConfigOption = None,
    jpeg_quality: Annotated[
        int | None, Option(min=1, max=100, metavar="Q", help="Write JPEG images of this quality (bags only).")
    ] = None,
    compression: Annotated[
        Literal["none", "zstd"], Option(help="Compress the chunks of the bag (mcap only).")
    ] = "none",
    truth_grid: Annotated[
        float | None, Option(metavar="M", help="Round true points to this grid spacing, a power of two (bags only).")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Convert a source to a bag, a folder or another data set layout; or convert a trajectory or a cloud.

    Sources are data set folders, ROS 1 and ROS 2 bags, and KITTI and EuRoC sequences.
    """
    from sfr_loc_map.io.clouds.cloud_file import SUFFIXES as CLOUDS
    from sfr_loc_map.io.convert import ConvertOptions, Layout
    from sfr_loc_map.io.convert import convert as run
    from sfr_loc_map.io.tables.trajectory_file import FILE_SUFFIXES, format_of_name

    layout = None if to is None else Layout(to)
    of_bags = ("jpeg_quality", "compression", "truth_grid")
    of_source = ("remap", "config")
    of_table = ("columns",)
    if source.suffix.lower() in CLOUDS and not source.is_dir():
        others = ("to", *of_bags, *of_source, *of_table)
        reason = f"has no effect, because '{source}' is a cloud, to which only '--overwrite' applies: omit it"
        refuse_given(context, others, reason)
        _convert_cloud(source, destination, overwrite=overwrite)
        return
    is_poses = not source.is_dir() and source.suffix in FILE_SUFFIXES
    if is_poses:
        reason = f"requires a source with images, but '{source}' is a trajectory: omit it"
        refuse_given(context, ("to", *of_source), reason)
    else:
        refuse_given(context, of_table, f"applies only to a trajectory, which '{source}' is not: omit it")
    if is_poses or (layout is None and format_of_name(destination) is not None):
        refuse_given(context, of_bags, "applies only to bags with images, but a trajectory is written: omit it")
        of_poses, of_truth = columns_of(columns)
        if of_truth:
            raise ConfigError(f"'--columns truth:{of_truth}': '{source}' is the only table: omit 'truth:'")
        _convert_trajectory(
            source, destination, remap, config, is_poses=is_poses, overwrite=overwrite, columns=of_poses
        )
        return
    if destination.suffix == PAIRS and layout is None:
        refuse_given(
            context, of_bags, f"applies only to bags, but '{destination}' is a file for a target board: omit it"
        )
        _convert_pairs(source, destination, remap, config, overwrite=overwrite)
        return
    options = ConvertOptions(jpeg_quality, compression == "zstd", truth_grid, layout)
    opened, _ = open_as(source, remap, config)
    parts = [part for part in (opened.loc, opened.nav) if part is not None]
    if layout is not None:
        if opened.loc is not None and opened.nav is not None:
            warn(f"the mapping pairs of '{source}' are ignored: the layout of {layout} has none")
        parts = [] if opened.loc is None else [opened.loc]
    room = output_folder(destination, overwrite=overwrite, inputs=(source,))
    with room as place, naming(source), progress_bar("pairs") as bar:
        task = bar.add_task("converting", total=sum(map(len, parts)))
        count = run(opened, place, options, lambda done: bar.update(task, completed=done))
    say(f"{count} pairs: {destination}", err=True)
    propose("sfr", "info", destination, why="is it complete")


def _convert_cloud(source: Path, destination: Path, *, overwrite: bool) -> None:
    """Write a cloud in another format."""
    from sfr_loc_map.io.clouds.cloud_file import SUFFIXES
    from sfr_loc_map.io.convert import convert_cloud

    check_suffix(destination, SUFFIXES)
    check_outputs(destination, inputs=(source,), overwrite=overwrite)
    count = convert_cloud(source, destination)
    say(f"{count} points: {destination}", err=True)
    propose("sfr", "score", destination, "SRC", why="against the truth of the mapping pairs")


def _convert_pairs(
    source: Path, destination: Path, remap: list[str] | None, config: Path | None, *, overwrite: bool
) -> None:
    """Write the pairs of a source for a target board; a drive starts at its first true pose, if known."""
    from sfr_loc_map.io.layouts.board_file import write_pairs
    from sfr_loc_map.runs.drive_start import true_start

    check_outputs(destination, inputs=files_read(source, config), overwrite=overwrite)
    opened, _ = open_as(source, remap, config)
    start = None if opened.loc is None else true_start(opened.loc).T_ds_rb
    with naming(source), progress_bar("pairs") as bar:
        total = sum(len(part) for part in (opened.loc, opened.nav) if part is not None)
        task = bar.add_task("converting", total=total)
        count = write_pairs(destination, opened, start, lambda done: bar.update(task, completed=done))
    say(f"{count} pairs: {destination}", err=True)
    why = "on the target (docs/howto/target.md), then sfr score results SRC"
    propose("./harness", destination, "results", why=why)


def _convert_trajectory(
    source: Path,
    destination: Path,
    remap: list[str] | None,
    config: Path | None,
    *,
    is_poses: bool,
    overwrite: bool,
    columns: str,
) -> None:
    """Write a trajectory, or the true trajectory of a source, as a file of poses, a folder or a bag."""
    from sfr_loc_map.io.convert import convert_trajectory
    from sfr_loc_map.io.registry import true_trajectory
    from sfr_loc_map.io.source_settings import source_config
    from sfr_loc_map.io.tables.trajectory_file import files_written, format_of_name, read_trajectory_file

    to_file = format_of_name(destination) is not None
    if to_file:
        check_outputs(*files_written(destination), inputs=files_read(source, config), overwrite=overwrite)
    if is_poses:
        read = read_trajectory_file(source, columns)
        poses = read.stamped
        if read.is_announced:
            say(read.text, err=True)
    else:
        how = source_config(source, config or announced_config(source), parse_remaps(remap))
        poses = true_trajectory(source, how)
    if to_file:
        count = convert_trajectory(poses, destination)
        propose("sfr", "score", "EST", destination, why="an estimate against these poses")
    else:
        with output_folder(destination, overwrite=overwrite, inputs=(source,)) as place:
            count = convert_trajectory(poses, place)
        propose("sfr", "info", destination, why="checks that it is complete")
    say(f"{count} poses: {destination}", err=True)
