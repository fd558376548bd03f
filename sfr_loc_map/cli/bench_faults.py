"""`sfr bench faults`: does the localiser ever give a wrong pose without saying so."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import examples
from sfr_loc_map.cli.bench_common import app, present
from sfr_loc_map.cli.options import (
    ConfigOption,
    JsonOption,
    LenientOption,
    OverwriteOption,
    RemapOption,
    open_drive,
    open_panorama,
    words,
)
from sfr_loc_map.cli.output import check_outputs, each_tenth, progress_bar
from sfr_loc_map.cli.verdict import check_conditions
from sfr_loc_map.config import read_config
from sfr_loc_map.errors import ConfigError, FailedVerdictError, InputError, InterruptedRunError

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import LocSequence

SourcesArgument = Annotated[
    list[Path], typer.Argument(metavar="SRC", help="Drives with ground truth; more than one only with --random.")
]
FaultOption = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        metavar="KIND[:...]",
        help="As for sfr perturb, several joined by +; repeatable. By default common faults.",
    ),
]
RandomOption = Annotated[
    int | None,
    typer.Option("--random", min=1, metavar="N", help="This many drives with random faults, over all sources."),
]


@app.command(
    epilog=examples(
        "sfr bench faults data/ --fault torn+noisy --json faults.json",
        "sfr bench faults data/ drive.mcap --random 100 --seed 4 --markdown faults.md",
    )
)
def faults(
    sources: SourcesArgument,
    fault: FaultOption = None,
    random: RandomOption = None,
    maps: Annotated[
        bool, typer.Option("--map", help="The mapper instead, on the mapping pairs of one source.")
    ] = False,
    pairs: Annotated[int, typer.Option(min=10, metavar="N", help="Most pairs of a drive with random faults.")] = 100,
    condition: Annotated[
        str,
        typer.Option(
            "--condition",
            metavar="distance=M|time=S|frames=N",
            autocompletion=words("distance=", "time=", "frames="),
            help="End of a sub-trajectory.",
        ),
    ] = "distance=5",
    spacing: Annotated[int, typer.Option(min=1, metavar="FRAMES", help="Frames from one start to the next.")] = 10,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed that selects the affected pairs.")] = 0,
    json_path: JsonOption = None,
    markdown_path: Annotated[
        Path | None, typer.Option("--markdown", metavar="F.md", help="The tables as Markdown.")
    ] = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
    config: ConfigOption = None,
    remap: RemapOption = None,
) -> None:
    """Localiser or mapper on data with faults: errors beside stated sigmas; exit 1 if one is wrong and does not say so.

    Faults that affect some pairs of a drive affect all pairs of a map, unless their text says otherwise.
    """
    check_outputs(json_path, markdown_path, overwrite=overwrite, inputs=sources)
    if maps:
        if random is not None:
            raise ConfigError("--random is of drives: leave it or --map out")
        _run_maps(sources, tuple(fault or ()), seed, (json_path, markdown_path), (config, remap))
        return
    if random is not None and fault:
        raise ConfigError("--random draws the faults: leave out --fault")
    if random is None and len(sources) > 1:
        raise ConfigError(f"{len(sources)} sources: give one, or --random N for random faults over all of them")
    drives = {str(source): _with_truth(source, remap) for source in sources}
    if random is not None:
        _run_random(drives, random, seed, pairs, (json_path, markdown_path), config)
    else:
        check_conditions(drives[str(sources[0])].ground_truth, (condition,), lenient=lenient)
        _run_each(drives, tuple(fault or ()), (condition, spacing, seed), (json_path, markdown_path), config)


def _run_each(
    drives: dict[str, LocSequence],
    fault: tuple[str, ...],
    scoring: tuple[str, int, int],
    outputs: tuple[str | None, Path | None],
    config: Path | None,
) -> None:
    """Run one drive with one fault at a time; scoring: condition, spacing, seed."""
    from sfr_loc_map.bench.fault_benchmark import FAULTS, benchmark_faults
    from sfr_loc_map.localisation.config import LocalisationConfig
    from sfr_loc_map.metrics.config import TrajectoryScoreConfig

    parameters = read_config(LocalisationConfig, config, "localisation")
    ((name, sequence),) = drives.items()
    condition, spacing, seed = scoring
    wanted = fault or FAULTS
    with progress_bar("faults") as bar:
        task = bar.add_task("localising", total=len(wanted) + 1)
        score_config = TrajectoryScoreConfig(conditions=(condition,), spacing=spacing)
        result = benchmark_faults(sequence, wanted, parameters, score_config, seed, lambda name: bar.advance(task))
    present({"source": name} | result.to_json(), *outputs)
    _judge(result.silent)


def _run_random(
    drives: dict[str, LocSequence],
    count: int,
    seed: int,
    pairs: int,
    outputs: tuple[str | None, Path | None],
    config: Path | None,
) -> None:
    """Run many drives with random faults; interrupted, show what was finished."""
    from sfr_loc_map.bench.fault_campaign import FaultCampaign, plan_drives, run_campaign
    from sfr_loc_map.localisation.config import LocalisationConfig

    parameters = read_config(LocalisationConfig, config, "localisation")
    plans, outcomes = plan_drives(drives, count, seed, pairs), []
    interrupted = False
    with progress_bar("drives") as bar:
        task = bar.add_task("localising", total=len(plans))
        report = each_tenth("localising", "drives")
        try:
            for outcome in run_campaign(drives, plans, parameters):
                outcomes.append(outcome)
                bar.advance(task)
                report(len(outcomes), len(plans))
        except KeyboardInterrupt:
            interrupted = True
    campaign = FaultCampaign(seed, outcomes)
    present({"sources": list(drives)} | campaign.to_json(), *outputs)
    if interrupted:
        raise InterruptedRunError(f"interrupted: {len(outcomes)} of {len(plans)} drives were finished")
    _judge([f"{outcome.plan.source}: {outcome.plan.faults}" for outcome in campaign.silent])


def _run_maps(
    sources: list[Path],
    fault: tuple[str, ...],
    seed: int,
    outputs: tuple[str | None, Path | None],
    reading: tuple[Path | None, list[str] | None],
) -> None:
    """Map the pairs of one source with one fault at a time; reading: configuration and remaps."""
    from sfr_loc_map.bench.map_fault_benchmark import MAP_FAULTS, benchmark_map_faults
    from sfr_loc_map.mapping.config import MappingConfig

    if len(sources) > 1:
        raise ConfigError(f"{len(sources)} sources: give one with --map")
    config, remap = reading
    parameters = read_config(MappingConfig, config, "mapping")
    sequence = open_panorama(sources[0], remap)
    wanted = fault or MAP_FAULTS
    with progress_bar("faults") as bar:
        task = bar.add_task("mapping", total=len(wanted) + 1)
        result = benchmark_map_faults(sequence, wanted, parameters, seed, lambda name: bar.advance(task))
    present({"source": str(sources[0])} | result.to_json(), *outputs)
    if result.silent:
        raise FailedVerdictError(
            f"wrong maps without a warning, more than {result.limit_share:.1%} of the points beyond 5 times their "
            f"stated 3 sigma: {', '.join(result.silent)}"
        )


def _with_truth(source: Path, remap: list[str] | None) -> LocSequence:
    sequence = open_drive(source, remap)
    if sequence.ground_truth is None:
        raise InputError(f"no drive with ground truth in '{source}': give a source that has one")
    return sequence


def _judge(silent: list[str]) -> None:
    if silent:
        shown = ", ".join(silent[:5]) + (f" and {len(silent) - 5} more" if len(silent) > 5 else "")
        raise FailedVerdictError(f"wrong and called tracking, beyond 5 times the stated 3 sigma: {shown}")
