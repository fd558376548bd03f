"""`sfr map`: map stereo pairs to a point cloud, offline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

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
    announced_config,
    given_words,
    method_under_test,
)
from sfr_loc_map.cli.output import check_suffix, claim_outputs, pairs_progress, say, secondary_output, warn
from sfr_loc_map.cli.verdict import conclude_findings
from sfr_loc_map.errors import InterruptedRunError, naming
from sfr_loc_map.mapping.config import CalibrationPrior, MappingConfig
from sfr_loc_map.message_text import counted
from sfr_loc_map.signals import hold
from sfr_loc_map.suite_names import OURS, Task


@app.command(
    name="map",
    epilog=examples(
        "sfr map data/ -o cloud.ply --stats stats.csv",
        "sfr map panorama.mcap -o cloud.npz --no-fuse",
        "sfr map data/ -o cloud.ply --dem site.tif --dem site.png --covariance",
        "sfr map data/ -o other.ply --stats other.stats.csv --method sgbm",
    ),
)
def map_cloud(
    context: Context,
    source: SourceArgument,
    output: Annotated[Path, Option("-o", "--output", metavar="C.ply", help="Cloud: .ply, .pcd or .npz.")],
    fuse: Annotated[bool, Option("--fuse/--no-fuse", help="Fuse the pairs, or keep the points of every pair.")] = True,
    dem: Annotated[
        list[Path] | None,
        Option(
            metavar="FILE",
            help="Also write the elevation grid that the node publishes: *.tif (GeoTIFF), *.npz, *.png; repeatable.",
        ),
    ] = None,
    covariance: Annotated[
        bool, Option("--covariance", help="Also write C.covariance.npz: a 3 x 3 matrix for each point, in cloud order.")
    ] = False,
    refine_poses: Annotated[
        bool | None,
        Option(
            "--refine-poses/--no-refine-poses",
            help="Correct the poses of later pairs by registration of the overlaps; default: as configured.",
        ),
    ] = None,
    stats: Annotated[
        Path | None, Option(metavar="S.csv", help="One row per call: time, memory, ...; default: C.stats.csv.")
    ] = None,
    config: ConfigOption = None,
    remap: RemapOption = None,
    overwrite: OverwriteOption = False,
    method: MethodOption = OURS,
    call_timeout: CallTimeoutOption = 120.0,
    memory_limit: MemoryLimitOption = 4000,
) -> None:
    """Map up to three stereo pairs with the code of the mapping node, or with another method."""
    from sfr_loc_map.calls.call_files import save_stats, stats_beside
    from sfr_loc_map.io.clouds.cloud_file import SUFFIXES
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.io.sequence import panorama_of
    from sfr_loc_map.runs.map_files import MapOutputs, check_dems, save_map
    from sfr_loc_map.runs.mapper_run import run_mapper

    check_suffix(output, SUFFIXES)
    stats = stats_beside(output) if stats is None else stats
    source_config = announced_config(source, config if method == OURS else None, remap)
    parameters = source_config.configuration.build(MappingConfig, "mapping")
    if refine_poses is not None:
        parameters = replace(parameters, refine_poses=refine_poses)
    check_dems(dem or ())
    outputs = MapOutputs(output, fuse, dem or (), parameters.terrain, covariance)
    claim_outputs(
        output, stats, *outputs.more, inputs=(source, source_config.configuration.path, config), overwrite=overwrite
    )
    opened = open_source(source, source_config)
    under_test = method_under_test(context, method, Task.MAPPING, opened, config, call_timeout, memory_limit)
    sequence = panorama_of(opened)
    with naming(source), pairs_progress("mapping", len(sequence)) as progress:
        run = run_mapper(sequence, under_test or parameters, progress, keeps_finished=True)
        hold()
    cloud = save_map(run, sequence.rig.fx, outputs, secondary_output)
    with secondary_output():
        save_stats(stats, run.records, {Task.MAPPING: run.method}, cloud=cloud)
    for line in run.warnings:
        warn(line)
    say(f"{len(cloud)} points of {counted(len(run.maps), 'pair')}: {output}", err=True)
    if under_test is None:
        say(_assumption(parameters.calibration), err=True)
    for path in outputs.more:
        say(str(path), err=True)
    given = given_words(context, "config") if under_test is None else []
    propose("sfr", "score", output, source, *given, why="against the truth, if the source has it")
    if len(run.maps) < len(sequence):
        raise InterruptedRunError(f"interrupted: {len(run.maps)} of {len(sequence)} pairs were mapped and written")
    conclude_findings(run.method, run.records)


def _assumption(calibration: CalibrationPrior) -> str:
    """Return the assumptions of sigma about the calibration, which no pair can verify."""
    return (
        f"sigma assumes the baseline within {calibration.baseline_share:.2%}, the focal length within "
        f"{calibration.focal_share:.2%}, the yaw of the right camera within {calibration.yaw_deg:g} deg "
        "(mapping.calibration)"
    )
