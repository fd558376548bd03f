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
from sfr_loc_map.cli.dem import write_dem_pages
from sfr_loc_map.cli.method import OURS, conclude_findings, method_limits, method_of
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import OverwriteOption, check_outputs, check_suffix, say, warn
from sfr_loc_map.errors import ConfigError

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import NavSequence
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.methods.method import MethodLimits
    from sfr_loc_map.metrics.method_record import MethodRecord
    from sfr_loc_map.pipeline.offline import MapRun, Progress

    MapSource = Callable[[NavSequence, Progress], tuple[MapRun, MethodRecord]]
    """Maps the pairs of a source and says whose the map is."""


DemOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="CELL_M|FILE",
        help="Also an elevation model, the grid of the topics: the side of its cells, 0.1 m unless given "
        "(C.dem.npz, C.dem.png), or a file *.tif (GeoTIFF), *.npz, *.png, *.html; may be given several times.",
    ),
]

CovarianceOption = Annotated[
    bool, typer.Option("--covariance", help="Also C.covariance.npz: 3 x 3 of each point, in the cloud's order.")
]
RefinePosesOption = Annotated[
    bool, typer.Option("--refine-poses", help="Correct the poses of later pairs by registration of the overlaps.")
]


@app.command(
    name="map",
    epilog=examples(
        "sfr map data/ -o cloud.ply --stats stats.csv",
        "sfr map panorama.mcap -o cloud.npz --no-fuse",
        "sfr map data/ -o cloud.ply --dem 0.05 --colour --covariance",
        "sfr map data/ -o cloud.laz --dem site.tif --dem site.html",
        "sfr map data/ -o other.ply --stats other.stats.csv --method sgbm",
    ),
)
def map_cloud(
    source: SourceArgument,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="C.ply", help="Cloud: .ply, .pcd, .npz, .las or .laz.")
    ],
    fuse: Annotated[bool, typer.Option("--fuse/--no-fuse", help="One cloud, or the points of every pair.")] = True,
    dem: DemOption = None,
    colour: Annotated[bool, typer.Option("--colour", help="Also C.colour.ply: points coloured by height.")] = False,
    covariance: CovarianceOption = False,
    refine_poses: RefinePosesOption = False,
    stats: Annotated[Path | None, typer.Option(metavar="S.csv", help="A row for each call: time, memory, ...")] = None,
    method: MethodOption = OURS,
    call_timeout: CallTimeoutOption = 120.0,
    memory_limit: MemoryLimitOption = 4000,
    config: ConfigOption = None,
    remap: RemapOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Map up to three stereo pairs, with the same code as the node, or by another method."""
    from sfr_loc_map.io.cloud_file import SUFFIXES, check_cloud_format
    from sfr_loc_map.pipeline.dem_products import dem_outputs
    from sfr_loc_map.pipeline.map_outputs import MapOutputs, map_warnings, save_map
    from sfr_loc_map.pipeline.offline import save_stats

    check_suffix(output, SUFFIXES)
    check_cloud_format(output)
    parameters = _parameters(config if method == OURS else None, refine_poses)
    outputs = MapOutputs(output, fuse, dem_outputs(dem or (), output, parameters.terrain), colour, covariance)
    check_outputs(output, stats, *outputs.more, overwrite=overwrite, inputs=(source,))
    limits = method_limits(call_timeout, memory_limit)
    mapper = _our_mapper(parameters) if method == OURS else _other_mapper(method, config, limits)
    if refine_poses and method != OURS:
        raise ConfigError(f"'--refine-poses' is of our mapper: leave it out with --method {method}")
    sequence = open_panorama(source, remap)
    with naming(source), progress_bar("pairs") as bar:
        task = bar.add_task("mapping", total=len(sequence))
        run, about = mapper(sequence, lambda done: bar.update(task, completed=done))
    saved = save_map(run, sequence.rig.fx, outputs)
    if saved.terrain is not None and outputs.dem is not None:
        write_dem_pages(outputs.dem.files, saved.terrain)
    if stats is not None:
        save_stats(stats, run.records, about)
    for line in map_warnings(run):
        warn(line)
    say(f"{len(saved.cloud)} points of {len(run.maps)} pairs: {output}", err=True)
    for path in outputs.more:
        say(str(path), err=True)
    propose("sfr", "score", output, source, why="against the truth, if the source has it")
    conclude_findings(about, run.records)


def _parameters(config: Path | None, refine_poses: bool) -> MappingConfig:
    from sfr_loc_map.mapping.config import MappingConfig

    parameters = read_config(MappingConfig, config, "mapping")
    return replace(parameters, refine_poses=True) if refine_poses else parameters


def _our_mapper(parameters: MappingConfig) -> MapSource:
    from sfr_loc_map.methods.method import MethodTask
    from sfr_loc_map.methods.registry import record_of_ours
    from sfr_loc_map.pipeline.offline import map_pairs

    return lambda sequence, progress: (map_pairs(sequence, parameters, progress), record_of_ours(MethodTask.MAP))


def _other_mapper(spec: str, config: Path | None, limits: MethodLimits) -> MapSource:
    from sfr_loc_map.methods.method import MethodTask
    from sfr_loc_map.pipeline.candidate import map_pairs_with

    method = method_of(spec, MethodTask.MAP, config)
    return lambda sequence, progress: map_pairs_with(method, sequence, limits, progress)
