"""`sfr convert`: any source to a ROS 2 bag or a data set folder."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.common import RemapOption, SourceArgument, parse_remaps, progress_bar


class Compression(StrEnum):
    """How chunks of a bag are compressed."""

    NONE = "none"
    ZSTD = "zstd"


def convert(
    source: SourceArgument,
    destination: Annotated[Path, typer.Argument(help="*.mcap, *.db3 or *.bag: a ROS 2 bag; else a data set folder.")],
    remap: RemapOption = None,
    jpeg_quality: Annotated[int | None, typer.Option(min=1, max=100, help="Pictures as JPEG (bags only).")] = None,
    compression: Annotated[Compression, typer.Option(help="Of a bag's chunks (mcap only).")] = Compression.NONE,
    truth_grid: Annotated[
        float | None, typer.Option(help="Round true points to this power of two, m (bags only).")
    ] = None,
) -> None:
    """Convert a data set folder, ROS 2 bag, KITTI or EuRoC sequence to a bag or a folder."""
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.pipeline.convert import ConvertOptions
    from sfr_loc_map.pipeline.convert import convert as run

    opened = open_source(source, parse_remaps(remap))
    total = sum(len(part) for part in (opened.loc, opened.nav) if part is not None)
    options = ConvertOptions(jpeg_quality, compression is Compression.ZSTD, truth_grid)
    with progress_bar("pairs") as bar:
        task = bar.add_task("converting", total=total)
        count = run(opened, destination, options, lambda done: bar.update(task, completed=done))
    typer.echo(f"{count} pairs: {destination}", err=True)
