"""`sfr map`: stereo pairs to a point cloud, offline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import (
    CallTimeoutOption,
    ConfigOption,
    MemoryLimitOption,
    MethodOption,
    RemapOption,
    SourceArgument,
    naming,
    open_panorama,
    progress_bar,
    read_config,
)
from sfr_loc_map.cli.method import OURS, conclude_findings, method_limits, method_of
from sfr_loc_map.cli.output import OverwriteOption, check_outputs, check_suffix, say
from sfr_loc_map.errors import ConfigError

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import NavSequence
    from sfr_loc_map.methods.method import MethodLimits
    from sfr_loc_map.metrics.score import MethodRecord
    from sfr_loc_map.pipeline.offline import MapRun, Progress

    MapSource = Callable[[NavSequence, Progress], tuple[MapRun, MethodRecord]]
    """Maps the pairs of a source and says whose the map is."""


@app.command(
    name="map",
    epilog=examples(
        "sfr map data/ -o cloud.ply --stats stats.csv",
        "sfr map panorama.mcap -o cloud.npz --no-fuse",
        "sfr map data/ -o cloud.ply --dem 0.05 --colour --covariance",
        "sfr map data/ -o other.ply --stats other.stats.csv --method sgbm",
    ),
)
def map_cloud(
    source: SourceArgument,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="C.ply", help="Cloud: .ply, .pcd or .npz.")],
    fuse: Annotated[bool, typer.Option("--fuse/--no-fuse", help="One cloud, or the points of every pair.")] = True,
    dem: Annotated[
        float | None,
        typer.Option(
            metavar="CELL_M", help="Also C.dem.npz and C.dem.png: height, sigma and count of cells this wide."
        ),
    ] = None,
    colour: Annotated[bool, typer.Option("--colour", help="Also C.colour.ply: points coloured by height.")] = False,
    covariance: Annotated[
        bool, typer.Option("--covariance", help="Also C.covariance.npz: 3 x 3 of each point, in the cloud's order.")
    ] = False,
    refine_poses: Annotated[
        bool, typer.Option("--refine-poses", help="Correct the poses of later pairs by registration of the overlaps.")
    ] = False,
    stats: Annotated[Path | None, typer.Option(metavar="S.csv", help="A row for each call: time, memory, ...")] = None,
    method: MethodOption = OURS,
    call_timeout: CallTimeoutOption = 120.0,
    memory_limit: MemoryLimitOption = 4000,
    config: ConfigOption = None,
    remap: RemapOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Map up to three stereo pairs, with the same code as the node, or by another method."""
    from sfr_loc_map.io.cloud_file import SUFFIXES
    from sfr_loc_map.pipeline.map_outputs import MapOutputs, map_warnings, save_map
    from sfr_loc_map.pipeline.offline import save_stats

    check_suffix(output, SUFFIXES)
    outputs = MapOutputs(output, fuse, dem, colour, covariance)
    check_outputs(output, stats, *outputs.beside.values(), overwrite=overwrite, inputs=(source,))
    limits = method_limits(call_timeout, memory_limit)
    mapper = _our_mapper(config, refine_poses) if method == OURS else _other_mapper(method, config, limits)
    if refine_poses and method != OURS:
        raise ConfigError(f"'--refine-poses' is of our mapper: leave it out with --method {method}")
    sequence = open_panorama(source, remap)
    with naming(source), progress_bar("pairs") as bar:
        task = bar.add_task("mapping", total=len(sequence))
        run, about = mapper(sequence, lambda done: bar.update(task, completed=done))
    cloud = save_map(run, sequence.rig.fx, outputs)
    if stats is not None:
        save_stats(stats, run.records, about)
    for line in map_warnings(run):
        say(f"Warning: {line}", err=True)
    say(f"{len(cloud)} points of {len(run.maps)} pairs: {output}", err=True)
    for path in outputs.beside.values():
        say(str(path), err=True)
    conclude_findings(about, run.records)


def _our_mapper(config: Path | None, refine_poses: bool) -> MapSource:
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.methods.method import MethodTask
    from sfr_loc_map.methods.registry import record_of_ours
    from sfr_loc_map.pipeline.offline import map_pairs

    parameters = read_config(MappingConfig, config, "mapping")
    if refine_poses:
        parameters = replace(parameters, refine_poses=True)
    return lambda sequence, progress: (map_pairs(sequence, parameters, progress), record_of_ours(MethodTask.MAP))


def _other_mapper(spec: str, config: Path | None, limits: MethodLimits) -> MapSource:
    from sfr_loc_map.methods.method import MethodTask
    from sfr_loc_map.pipeline.candidate import map_pairs_with

    method = method_of(spec, MethodTask.MAP, config)
    return lambda sequence, progress: map_pairs_with(method, sequence, limits, progress)
