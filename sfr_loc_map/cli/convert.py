"""`sfr convert`: convert a source to a bag, a folder or another data set layout; or convert a trajectory or a cloud."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

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
    refuse_others,
)
from sfr_loc_map.cli.output import check_suffix, claim_outputs, output_folder, pairs_progress, say, warn
from sfr_loc_map.errors import ConfigError, naming
from sfr_loc_map.suffixes import suffix_of

if TYPE_CHECKING:
    from sfr_loc_map.geometry.trajectory import Trajectory
    from sfr_loc_map.io.convert import ConvertOptions

PAIRS = ".sfrp"  #: Suffix of a file of pairs for a target board.


class Conversion(StrEnum):
    """What is converted, as stated in the message about an option that does not apply."""

    CLOUD = "a cloud"
    TRAJECTORY = "a trajectory"
    TRUE_TRAJECTORY = "the true trajectory of a source"
    BOARD_PAIRS = "pairs for a target board"
    SOURCE = "a source with images"


OF_ALL = ("source", "destination", "overwrite")  #: Arguments and options of all conversions.
OF_CONVERSION: dict[Conversion, tuple[str, ...]] = {
    Conversion.CLOUD: (),
    Conversion.TRAJECTORY: ("columns",),
    Conversion.TRUE_TRAJECTORY: ("remap", "config"),
    Conversion.BOARD_PAIRS: ("remap", "config"),
    Conversion.SOURCE: ("remap", "config", "to", "jpeg_quality", "compression", "truth_grid"),
}
"""Further options of each conversion."""


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
    from sfr_loc_map.io.convert import ConvertOptions, Layout

    kind = _conversion_of(source, destination, to)
    refuse_others(context, (*OF_ALL, *OF_CONVERSION[kind]), f"does not apply to {kind}: omit it")
    match kind:
        case Conversion.CLOUD:
            _convert_cloud(source, destination, overwrite=overwrite)
        case Conversion.TRAJECTORY:
            _convert_trajectory(source, destination, columns, overwrite=overwrite)
        case Conversion.TRUE_TRAJECTORY:
            _write_true_trajectory(source, destination, remap, config, overwrite=overwrite)
        case Conversion.BOARD_PAIRS:
            _convert_pairs(source, destination, remap, config, overwrite=overwrite)
        case Conversion.SOURCE:
            layout = None if to is None else Layout(to)
            options = ConvertOptions(jpeg_quality, compression == "zstd", truth_grid, layout)
            _convert_source(source, destination, options, remap, config, overwrite=overwrite)


def _conversion_of(source: Path, destination: Path, layout: str | None) -> Conversion:
    """Return the conversion that both paths and the layout (`--to`) imply.

    A file other than a cloud or a bag is a table of poses if its suffix or the suffix of the output is that of a table.
    """
    from sfr_loc_map.io.clouds.cloud_file import SUFFIXES as CLOUDS
    from sfr_loc_map.io.source_format import is_bag
    from sfr_loc_map.io.tables.trajectory_writer import FILE_SUFFIXES, format_of_name

    if not source.is_dir() and suffix_of(source) in CLOUDS:
        return Conversion.CLOUD
    if not source.is_dir() and suffix_of(source) in FILE_SUFFIXES:
        return Conversion.TRAJECTORY
    if layout is None and format_of_name(destination) is not None:
        is_table = source.is_file() and not is_bag(source)
        return Conversion.TRAJECTORY if is_table else Conversion.TRUE_TRAJECTORY
    if layout is None and suffix_of(destination) == PAIRS:
        return Conversion.BOARD_PAIRS
    return Conversion.SOURCE


def _convert_source(
    source: Path,
    destination: Path,
    options: ConvertOptions,
    remap: list[str] | None,
    config: Path | None,
    *,
    overwrite: bool,
) -> None:
    """Write a source as a bag, a folder or another layout."""
    from sfr_loc_map.io.convert import convert as run
    from sfr_loc_map.io.registry import open_source

    opened = open_source(source, announced_config(source, config, remap))
    parts = [part for part in (opened.loc, opened.nav) if part is not None]
    if options.layout is not None:
        if opened.loc is not None and opened.nav is not None:
            warn(f"the mapping pairs of '{source}' are ignored: the layout of {options.layout} has none")
        parts = [] if opened.loc is None else [opened.loc]
    room = output_folder(destination, overwrite=overwrite, inputs=(source,))
    with room as place, naming(source), pairs_progress("converting", sum(map(len, parts))) as progress:
        count = run(opened, place, options, progress)
    say(f"{count} pairs: {destination}", err=True)
    propose("sfr", "info", destination, why="checks that it is complete")


def _convert_cloud(source: Path, destination: Path, *, overwrite: bool) -> None:
    """Write a cloud in another format."""
    from sfr_loc_map.io.clouds.cloud_file import SUFFIXES
    from sfr_loc_map.io.convert import convert_cloud

    check_suffix(destination, SUFFIXES)
    claim_outputs(destination, inputs=(source,), overwrite=overwrite)
    count = convert_cloud(source, destination)
    say(f"{count} points: {destination}", err=True)
    propose("sfr", "score", destination, "SRC", why="against the truth of the mapping pairs")


def _convert_pairs(
    source: Path, destination: Path, remap: list[str] | None, config: Path | None, *, overwrite: bool
) -> None:
    """Write the pairs of a source for a target board, with the start pose of the drive.

    The start pose is the true pose at the first pair, or the identity if the source has no true attitudes.
    """
    from sfr_loc_map.io.layouts.board_file import write_pairs
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.runs.drive_start import true_start

    source_config = announced_config(source, config, remap)
    claim_outputs(destination, inputs=(source, source_config.configuration.path), overwrite=overwrite)
    opened = open_source(source, source_config)
    start = None if opened.loc is None else true_start(opened.loc).T_ds_rb
    total = sum(len(part) for part in (opened.loc, opened.nav) if part is not None)
    with naming(source), pairs_progress("converting", total) as progress:
        count = write_pairs(destination, opened, start, progress)
    say(f"{count} pairs: {destination}", err=True)
    why = "on the target (docs/howto/target.md), then sfr score results SRC"
    propose("./harness", destination, "results", why=why)


def _convert_trajectory(source: Path, destination: Path, columns: list[str] | None, *, overwrite: bool) -> None:
    """Write a trajectory as a file of poses, a folder or a bag."""
    from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
    from sfr_loc_map.io.tables.trajectory_writer import files_written, format_of_name

    of_poses, of_truth = columns_of(columns)
    if of_truth:
        raise ConfigError(f"'--columns truth:{of_truth}': '{source}' is the only table: omit 'truth:'")
    if format_of_name(destination) is not None:  # before the source is read; `output_folder` checks other outputs
        claim_outputs(*files_written(destination), inputs=(source,), overwrite=overwrite)
    read = read_trajectory_file(source, of_poses)
    if read.is_announced:
        say(read.text, err=True)
    _write_poses(read.stamped, source, destination, overwrite=overwrite)


def _write_true_trajectory(
    source: Path, destination: Path, remap: list[str] | None, config: Path | None, *, overwrite: bool
) -> None:
    """Write the true trajectory of a source as a file of poses."""
    from sfr_loc_map.io.registry import read_truth
    from sfr_loc_map.io.tables.trajectory_writer import files_written

    source_config = announced_config(source, config, remap)
    claim_outputs(*files_written(destination), inputs=(source, source_config.configuration.path), overwrite=overwrite)
    _write_poses(read_truth(source, source_config), source, destination, overwrite=overwrite)


def _write_poses(poses: Trajectory, source: Path, destination: Path, *, overwrite: bool) -> None:
    """Write poses as a file of poses, a folder or a bag."""
    from sfr_loc_map.io.convert import convert_trajectory
    from sfr_loc_map.io.tables.trajectory_writer import format_of_name

    if format_of_name(destination) is not None:
        count = convert_trajectory(poses, destination)
        propose("sfr", "score", "EST", destination, why="an estimate against these poses")
    else:
        with output_folder(destination, overwrite=overwrite, inputs=(source,)) as place:
            count = convert_trajectory(poses, place)
        propose("sfr", "info", destination, why="checks that it is complete")
    say(f"{count} poses: {destination}", err=True)
