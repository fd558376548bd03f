"""`sfr bench`: benchmarks beside other tools, on the same input, in the same run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from sfr_loc_map.cli.app import help_without_command
from sfr_loc_map.cli.common import (
    ConditionOption,
    ConfigOption,
    RemapOption,
    SourceArgument,
    open_drive,
    open_panorama,
    progress_bar,
    read_config,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, JsonOption, check_json, show
from sfr_loc_map.errors import InputError

app = typer.Typer(help="Benchmarks beside other tools: same input, same run, own processes.")
app.callback(invoke_without_command=True)(help_without_command)

PeerPythonOption = Annotated[
    Path | None, typer.Option("--peer-python", help="Interpreter that has the optional reference methods.")
]
RepeatOption = Annotated[int, typer.Option("--repeat", min=1, help="Passes; medians are shown.")]
SizesOption = Annotated[int, typer.Option("--sizes", min=1, max=5, help="Image sizes, each half of the one before.")]
SpacingOption = Annotated[int, typer.Option(min=1, help="Frames from one start to the next.")]


@app.command()
def localise(
    source: SourceArgument,
    peer_python: PeerPythonOption = None,
    vocabulary: Annotated[Path | None, typer.Option("--vocab", help="Vocabulary of ORB-SLAM3 (text).")] = None,
    condition: ConditionOption = None,
    spacing: SpacingOption = 10,
    repeat: RepeatOption = 3,
    sizes: SizesOption = 1,
    rate: Annotated[
        float | None,
        typer.Option(min=0.01, help="Pairs per second for methods that work in the background; default: as recorded."),
    ] = None,
    json_path: JsonOption = None,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Our localiser against a plain OpenCV one and, where installed, ORB-SLAM3 (pyorbslam3)."""
    from sfr_loc_map.bench.localisation_benchmark import BenchmarkSettings, benchmark_localisation
    from sfr_loc_map.bench.reference_methods import localisation_methods
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.metrics.condition import Condition
    from sfr_loc_map.metrics.config import TrajectoryScoreConfig

    conditions = tuple(condition or ["distance=5"])
    for text in conditions:
        Condition.parse(text)
    check_json(json_path)
    parameters = read_config(LocalisationConfig, config, "localisation")
    sequence = open_drive(source, remap)
    methods = localisation_methods(peer_python, vocabulary)
    settings = BenchmarkSettings(
        TrajectoryScoreConfig(conditions=conditions, spacing=spacing), repeat, sizes, rate_hz=rate
    )
    with progress_bar("calls") as bar:
        task = bar.add_task("measuring", total=len(sequence) * len(methods.present) * repeat * sizes)
        result = benchmark_localisation(sequence, parameters, methods, settings, lambda name: bar.advance(task))
    _present({"source": str(source)} | result.to_json(), json_path)


@app.command(name="map")
def map_(
    source: SourceArgument,
    peer_python: PeerPythonOption = None,
    repeat: RepeatOption = 3,
    sizes: SizesOption = 1,
    json_path: JsonOption = None,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Our mapper against OpenCV's semi-global matching and, where installed, Pandora."""
    from sfr_loc_map.bench.mapping_benchmark import benchmark_mapping
    from sfr_loc_map.bench.reference_methods import mapping_methods
    from sfr_loc_map.mapping.config import MappingConfig

    check_json(json_path)
    parameters = read_config(MappingConfig, config, "mapping")
    sequence = open_panorama(source, remap)
    methods = mapping_methods(peer_python)
    with progress_bar("calls") as bar:
        task = bar.add_task("measuring", total=len(sequence) * len(methods.present) * repeat * sizes)
        result = benchmark_mapping(
            sequence, parameters, methods, repeat=repeat, sizes=sizes, progress=lambda name: bar.advance(task)
        )
    _present({"source": str(source)} | result.to_json(), json_path)


@app.command()
def score(
    poses: Annotated[int, typer.Option(min=200, help="Poses of the synthetic drive.")] = 1_000_000,
    peer_python: PeerPythonOption = None,
    repeat: RepeatOption = 1,
    all_pairs: Annotated[
        bool, typer.Option("--all-pairs/--no-all-pairs", help="Run evo's slow form, every start, as well.")
    ] = True,
    json_path: JsonOption = None,
) -> None:
    """Our trajectory score against evo (evo_rpe), reading of the files included."""
    from sfr_loc_map.bench.score_benchmark import benchmark_score

    check_json(json_path)
    with progress_bar("commands") as bar:
        task = bar.add_task("measuring", total=None)
        result = benchmark_score(
            poses, peer_python, repeat=repeat, all_pairs=all_pairs, progress=lambda name: bar.advance(task)
        )
    _present(result.to_json(), json_path)


@app.command()
def faults(
    source: SourceArgument,
    fault: Annotated[
        list[str] | None,
        typer.Option("--fault", help="As for `sfr perturb`, several joined by +; repeatable. Default: common faults."),
    ] = None,
    condition: Annotated[str, typer.Option("--condition", help="End of a sub-trajectory.")] = "distance=5",
    spacing: SpacingOption = 10,
    seed: Annotated[int, typer.Option(min=0, help="Seed that selects the affected pairs.")] = 0,
    json_path: JsonOption = None,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Our localiser on a drive with one fault at a time: errors, lost pairs, silent jumps."""
    from sfr_loc_map.bench.fault_benchmark import FAULTS, benchmark_faults
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.metrics.config import TrajectoryScoreConfig

    check_json(json_path)
    parameters = read_config(LocalisationConfig, config, "localisation")
    sequence = open_drive(source, remap)
    if sequence.ground_truth is None:
        raise InputError(f"no drive with ground truth in '{source}': give a source that has one")
    wanted = tuple(fault) if fault else FAULTS
    with progress_bar("faults") as bar:
        task = bar.add_task("localising", total=len(wanted) + 1)
        scoring = TrajectoryScoreConfig(conditions=(condition,), spacing=spacing)
        result = benchmark_faults(sequence, wanted, parameters, scoring, seed, lambda name: bar.advance(task))
    _present({"source": str(source)} | result.to_json(), json_path)


def _present(result: dict[str, Any], json_path: str | None) -> None:
    """Print tables, reference methods left out and failures, and write the JSON; with `--json -` the JSON alone."""
    from sfr_loc_map.bench.tables import benchmark_tables
    from sfr_loc_map.metrics.records.json_records import json_line

    show(json_line(result), json_path, benchmark_tables(result))
    if json_path == STANDARD_OUTPUT:
        return
    for name, reason in result["missing"].items():
        typer.echo(f"left out: {name}: {reason}")
    for part in (result, *result.get("sizes", ())):
        for name, reason in part.get("failed", {}).items():
            typer.echo(f"failed: {name}: {reason}")
