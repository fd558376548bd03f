"""`sfr bench`: benchmarks beside other tools, on the same input, in the same run."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from sfr_loc_map.cli.common import (
    ConfigOption,
    RemapOption,
    SourceArgument,
    parse_remaps,
    progress_bar,
    read_config,
)
from sfr_loc_map.errors import InputError

app = typer.Typer(help="Benchmarks beside other tools: same input, same run, own processes.")

PeerPythonOption = Annotated[
    Path | None,
    typer.Option("--peer-python", help="Interpreter that has the optional reference methods."),
]
RepeatOption = Annotated[int, typer.Option("--repeat", min=1, help="Passes; medians are shown.")]
SizesOption = Annotated[int, typer.Option("--sizes", min=1, max=5, help="Image sizes, each half of the one before.")]
JsonOption = Annotated[Path | None, typer.Option("--json", help="All figures as JSON; - for standard output.")]


@app.callback(invoke_without_command=True)
def _root(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
def localise(
    source: SourceArgument,
    peer_python: PeerPythonOption = None,
    vocabulary: Annotated[Path | None, typer.Option("--vocab", help="Vocabulary of ORB-SLAM3 (text).")] = None,
    condition: Annotated[
        list[str] | None,
        typer.Option("--condition", help="End of a sub-trajectory: distance=M, time=S or frames=N; repeatable."),
    ] = None,
    spacing: Annotated[int, typer.Option(min=1, help="Frames from one start to the next.")] = 10,
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
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.metrics.condition import Condition
    from sfr_loc_map.metrics.config import TrajectoryScoreConfig

    conditions = tuple(condition or ["distance=5"])
    for text in conditions:
        Condition.parse(text)
    parameters = read_config(LocalisationConfig, config, "localisation")
    sequence = open_source(source, parse_remaps(remap)).loc
    if sequence is None or not len(sequence):
        raise InputError(f"no drive (localisation pairs) in '{source}': give a source that has one")
    methods = localisation_methods(peer_python, vocabulary)
    settings = BenchmarkSettings(
        TrajectoryScoreConfig(conditions=conditions, spacing=spacing), repeat, sizes, rate_hz=rate
    )
    with progress_bar("calls") as bar:
        task = bar.add_task("measuring", total=len(sequence) * len(methods.present) * repeat * sizes)
        result = benchmark_localisation(sequence, parameters, methods, settings, lambda name: bar.advance(task))
    _show({"source": str(source)} | result.to_json(), json_path)


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
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.mapping.config import MappingConfig

    parameters = read_config(MappingConfig, config, "mapping")
    sequence = open_source(source, parse_remaps(remap)).nav
    if sequence is None or not len(sequence):
        raise InputError(f"no mapping pairs in '{source}': give a source that has them")
    methods = mapping_methods(peer_python)
    with progress_bar("calls") as bar:
        task = bar.add_task("measuring", total=len(sequence) * len(methods.present) * repeat * sizes)
        result = benchmark_mapping(
            sequence, parameters, methods, repeat=repeat, sizes=sizes, progress=lambda name: bar.advance(task)
        )
    _show({"source": str(source)} | result.to_json(), json_path)


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

    with progress_bar("commands") as bar:
        task = bar.add_task("measuring", total=None)
        result = benchmark_score(
            poses, peer_python, repeat=repeat, all_pairs=all_pairs, progress=lambda name: bar.advance(task)
        )
    _show(result.to_json(), json_path)


@app.command()
def faults(
    source: SourceArgument,
    fault: Annotated[
        list[str] | None,
        typer.Option("--fault", help="As for `sfr perturb`, several joined by +; repeatable. Default: common faults."),
    ] = None,
    condition: Annotated[str, typer.Option("--condition", help="End of a sub-trajectory.")] = "distance=5",
    spacing: Annotated[int, typer.Option(min=1, help="Frames from one start to the next.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Seed of which pairs are affected.")] = 0,
    json_path: JsonOption = None,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Our localiser on a drive with one fault at a time: errors, lost pairs, silent jumps."""
    from sfr_loc_map.bench.fault_benchmark import FAULTS, benchmark_faults
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.metrics.config import TrajectoryScoreConfig

    parameters = read_config(LocalisationConfig, config, "localisation")
    sequence = open_source(source, parse_remaps(remap)).loc
    if sequence is None or not len(sequence) or sequence.ground_truth is None:
        raise InputError(f"no drive with ground truth in '{source}': give a source that has one")
    wanted = tuple(fault) if fault else FAULTS
    with progress_bar("faults") as bar:
        task = bar.add_task("localising", total=len(wanted) + 1)
        scoring = TrajectoryScoreConfig(conditions=(condition,), spacing=spacing)
        result = benchmark_faults(sequence, wanted, parameters, scoring, seed, lambda name: bar.advance(task))
    _show({"source": str(source)} | result.to_json(), json_path)


def _show(result: dict[str, Any], json_path: Path | None) -> None:
    """Print the tables and write the JSON; with `--json -` the JSON alone."""
    from rich.console import Console

    from sfr_loc_map.cli.bench_tables import tables
    from sfr_loc_map.io.atomic import atomic_path
    from sfr_loc_map.metrics.results import to_json, without_nan

    text = to_json(without_nan(result))
    if str(json_path) == "-":
        sys.stdout.write(text)
        return
    if json_path is not None:
        with atomic_path(json_path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    console = Console()
    console = console if console.is_terminal else Console(width=150)
    for table in tables(result):
        console.print(table)
    for name, reason in result["missing"].items():
        console.print(f"left out: {name}: {reason}", markup=False)
    failed = {
        name: reason for part in [result, *result.get("sizes", [])] for name, reason in part.get("failed", {}).items()
    }
    for name, reason in failed.items():
        console.print(f"failed: {name}: {reason}", markup=False)
