"""`sfr bench`: benchmarks beside other tools, on the same input, in the same run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli import bench_faults
from sfr_loc_map.cli.app import examples
from sfr_loc_map.cli.bench_common import app, present
from sfr_loc_map.cli.options import (
    ConditionOption,
    ConfigOption,
    JsonOption,
    LenientOption,
    OverwriteOption,
    RemapOption,
    SourceArgument,
    complete_methods,
    open_drive,
    open_panorama,
)
from sfr_loc_map.cli.output import check_outputs, progress_bar
from sfr_loc_map.cli.verdict import check_conditions
from sfr_loc_map.config import read_config

assert bench_faults  # its import adds `sfr bench faults`

PeerPythonOption = Annotated[
    Path | None,
    typer.Option("--peer-python", metavar="PYTHON", help="Interpreter that has the optional reference methods."),
]
AddedOption = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        metavar="NAME|package.module:Class|lib:FILE.so",
        autocompletion=complete_methods,
        help="One more method to compare; repeatable.",
    ),
]
RepeatOption = Annotated[int, typer.Option("--repeat", min=1, metavar="N", help="Passes; medians are shown.")]
SizesOption = Annotated[
    int, typer.Option("--sizes", min=1, max=5, metavar="N", help="Image sizes, each half of the one before.")
]
SpacingOption = Annotated[int, typer.Option(min=1, metavar="FRAMES", help="Frames from one start to the next.")]


@app.command(epilog=examples("sfr bench localise data/ --repeat 3 --json bench.json"))
def localise(
    source: SourceArgument,
    peer_python: PeerPythonOption = None,
    vocabulary: Annotated[
        Path | None, typer.Option("--vocab", metavar="F.txt", help="Vocabulary of ORB-SLAM3 (text).")
    ] = None,
    method: AddedOption = None,
    condition: ConditionOption = None,
    spacing: SpacingOption = 10,
    repeat: RepeatOption = 3,
    sizes: SizesOption = 1,
    rate: Annotated[
        float | None,
        typer.Option(
            min=0.01, metavar="HZ", help="Pairs for methods that work in the background; default: as recorded."
        ),
    ] = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Our localiser against a plain OpenCV one, ORB-SLAM3 (pyorbslam3) where installed, and any other method."""
    from sfr_loc_map.bench.competitors import competitors
    from sfr_loc_map.bench.localisation_benchmark import BenchmarkSettings, benchmark_localisation
    from sfr_loc_map.inputs import Task
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.metrics.config import TrajectoryScoreConfig

    conditions = tuple(condition or ["distance=5"])
    check_outputs(json_path, overwrite=overwrite)
    parameters = read_config(LocalisationConfig, config, "localisation")
    sequence = open_drive(source, remap)
    check_conditions(sequence.ground_truth, conditions, lenient=lenient)
    methods = competitors(Task.LOCALISATION, peer_python, vocabulary, method or ())
    settings = BenchmarkSettings(
        TrajectoryScoreConfig(conditions=conditions, spacing=spacing), repeat, sizes, rate_hz=rate
    )
    with progress_bar("calls") as bar:
        task = bar.add_task("measuring", total=len(sequence) * len(methods.present) * repeat * sizes)
        result = benchmark_localisation(sequence, parameters, methods, settings, lambda name: bar.advance(task))
    present({"source": str(source)} | result.to_json(), json_path)


@app.command(name="map", epilog=examples("sfr bench map data/ --sizes 2 --json bench.json"))
def map_(
    source: SourceArgument,
    peer_python: PeerPythonOption = None,
    method: AddedOption = None,
    repeat: RepeatOption = 3,
    sizes: SizesOption = 1,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Our mapper against OpenCV's semi-global matching, Pandora where installed, and any other method."""
    from sfr_loc_map.bench.competitors import competitors
    from sfr_loc_map.bench.mapping_benchmark import benchmark_mapping
    from sfr_loc_map.inputs import Task
    from sfr_loc_map.mapping.config import MappingConfig

    check_outputs(json_path, overwrite=overwrite)
    parameters = read_config(MappingConfig, config, "mapping")
    sequence = open_panorama(source, remap)
    methods = competitors(Task.MAPPING, peer_python, added=method or ())
    with progress_bar("calls") as bar:
        task = bar.add_task("measuring", total=len(sequence) * len(methods.present) * repeat * sizes)
        result = benchmark_mapping(
            sequence, parameters, methods, repeat=repeat, sizes=sizes, progress=lambda name: bar.advance(task)
        )
    present({"source": str(source)} | result.to_json(), json_path)


@app.command(epilog=examples("sfr bench score --poses 100000 --no-all-pairs"))
def score(
    poses: Annotated[int, typer.Option(min=200, metavar="N", help="Poses of the synthetic drive.")] = 1_000_000,
    peer_python: PeerPythonOption = None,
    repeat: RepeatOption = 1,
    all_pairs: Annotated[
        bool, typer.Option("--all-pairs/--no-all-pairs", help="Run evo's slow form, every start, as well.")
    ] = True,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Our trajectory score against evo (evo_rpe), reading of the files included."""
    from sfr_loc_map.bench.score_benchmark import benchmark_score

    check_outputs(json_path, overwrite=overwrite)
    with progress_bar("commands") as bar:
        task = bar.add_task("measuring", total=None)
        result = benchmark_score(
            poses, peer_python, repeat=repeat, all_pairs=all_pairs, progress=lambda name: bar.advance(task)
        )
    present(result.to_json(), json_path)
