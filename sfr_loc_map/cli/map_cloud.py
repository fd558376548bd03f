"""`sfr map`: stereo pairs to a point cloud, offline."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli.common import (
    ConfigOption,
    RemapOption,
    SourceArgument,
    check_output,
    naming,
    parse_remaps,
    progress_bar,
    read_config,
)
from sfr_loc_map.errors import InputError


def map_cloud(
    source: SourceArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="Cloud: .ply, .pcd or .npz.")],
    fuse: Annotated[bool, typer.Option("--fuse/--no-fuse", help="One cloud, or the points of every pair.")] = True,
    stats: Annotated[Path | None, typer.Option(help="CSV with a row for each call: time, memory, ...")] = None,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Map up to three stereo pairs, with the same code as the node."""
    from sfr_loc_map.io.cloud_file import SUFFIXES, save_cloud
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.pipeline.offline import map_pairs, save_stats

    check_output(output, SUFFIXES)
    check_output(stats)
    parameters = read_config(MappingConfig, config, "mapping")
    sequence = open_source(source, parse_remaps(remap)).nav
    if sequence is None:
        raise InputError(f"no mapping pairs in '{source}': give a source that has them")
    with naming(source), progress_bar("pairs") as bar:
        task = bar.add_task("mapping", total=len(sequence))
        run = map_pairs(sequence, parameters, lambda done: bar.update(task, completed=done))
    cloud = run.fused.cloud if fuse else run.unfused
    save_cloud(output, cloud)
    if stats is not None:
        save_stats(stats, run.records)
    typer.echo(f"{len(cloud)} points of {len(run.maps)} pairs: {output}", err=True)
