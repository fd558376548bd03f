"""`sfr simulate`: a rendered data set with exact truth, or a copy of a source with injected faults."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated

from typer import Argument, Context, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import (
    ConfigOption,
    OverwriteOption,
    RemapOption,
    announced_config,
    parse_settings,
    refuse_given,
)
from sfr_loc_map.cli.output import output_folder, pairs_progress, progress_bar, say
from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError, InterruptedRunError, naming
from sfr_loc_map.simulation.config import SimulationConfig

FAULT_KINDS = [
    "dropped",
    "repeated",
    "swapped",
    "identical",
    "late",
    "black",
    "interlaced",
    "start",
    "frozen",
    "torn",
    "ghost",
    "saturation",
    "blinded",
    "blurred",
    "noisy",
    "exposure",
    "shear",
    "fade",
    "object",
    "arm",
    "body",
    "texture",
    "reflection",
    "scratch",
    "dirt",
    "shadow",
    "focal",
    "baseline",
    "roll",
    "pitch",
    "yaw",
    "drift",
    "shift",
    "clock",
]
"""Names of `FaultKind`, whose module requires NumPy, for the help."""
FAULT_HELP = (
    "KIND, or KIND:OPTIONS with amount=A (unit: docs/simulation.md), share=S of the pairs (0 to 1), burst=N pairs "
    "at a time, start=N (first pair), camera=both|left|right, separated by commas; repeatable. "
    f"Kinds: {', '.join(FAULT_KINDS)}."
)


@app.command(
    epilog=examples(
        "sfr simulate data/",
        "sfr simulate config/simulation/sample.yaml data/ --seed 4 --workers 4",
        "sfr simulate data/ --set terrain.relief_m=0.2 --set loc.width=512",
        "sfr simulate faulty/ --from data/ --fault dropped:share=0.2 --fault blurred:amount=3,camera=left",
        "sfr simulate faulty.mcap --from drive.mcap --fault body:amount=0.3 --seed 4",
    )
)
def simulate(
    context: Context,
    paths: Annotated[
        list[Path],
        Argument(metavar="[CONFIG] OUT", help="YAML file of a scenario (optional), then the output folder or bag."),
    ],
    source: Annotated[
        Path | None, Option("--from", metavar="SRC", help="Copy this source with faults instead of rendering.")
    ] = None,
    fault: Annotated[list[str] | None, Option(metavar="KIND[:...]", help=FAULT_HELP)] = None,
    seed: Annotated[int | None, Option(min=0, metavar="N", help="Seed of all random numbers.")] = None,
    config_file: ConfigOption = None,
    remap: RemapOption = None,
    workers: Annotated[int, Option(min=1, metavar="N", help="Number of processes.")] = 2,
    settings: Annotated[
        list[str] | None, Option("--set", metavar="KEY=VALUE", help="A setting, for example terrain.relief_m=0.2.")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Render a drive or a panorama with exact truth. The same command continues an interrupted run.

    With --from SRC and --fault: copy a source and inject faults of single pairs, of the cameras, of the view, of the
    clock or of the calibration.
    """
    if source is not None:
        of_rendering = ("settings", "workers")
        refuse_given(context, of_rendering, "has no effect with --from, which copies a recording: omit it")
        if len(paths) > 1:
            raise ConfigError(f"'{paths[0]}' has no effect with --from, which copies a recording: give only the output")
        _inject(source, paths[0], fault, seed or 0, config_file, remap, overwrite=overwrite)
        return
    of_recording = ("fault", "config_file", "remap")
    refuse_given(context, of_recording, "applies only to a recording: give --from SRC, or omit it")
    from sfr_loc_map.simulation.simulate import can_continue
    from sfr_loc_map.simulation.simulate import simulate as run

    if len(paths) > 2:
        raise ConfigError(f"{len(paths)} paths given: a configuration (optional) and an output are required")
    values = flatten(load_yaml(paths[0]), keeps_empty=True) if len(paths) == 2 else {}
    values.update(parse_settings(settings, "KEY=VALUE is required, such as terrain.relief_m=0.2"))
    if seed is not None:
        values["seed"] = seed
    origins = [str(path) for path in paths[:-1]] + (["--set"] if settings else [])
    config = build(SimulationConfig, values, origin=" and ".join(origins) or "settings")
    out = paths[-1]
    room: AbstractContextManager[Path] = output_folder(out, overwrite=overwrite, inputs=paths[:-1], resumable=True)
    with nullcontext(out) if can_continue(config, out) else room as place, progress_bar("images") as bar:
        task = bar.add_task("rendering", total=None)
        try:
            count = run(config, place, workers, lambda done, total: bar.update(task, completed=done, total=total))
        except KeyboardInterrupt:
            text = f"interrupted: the finished images are in '{place}'; repeat the command to render the others"
            raise InterruptedRunError(text) from None
    say(f"{count} pairs: {out}", err=True)
    start = ("--start", "truth") if config.drive.enabled else ()
    words = ("sfr", "replay", out, *start, "--out", f"{out}_result")
    propose(*words, why="plays it to the nodes and scores the results")


def _inject(
    source: Path,
    destination: Path,
    fault: list[str] | None,
    seed: int,
    config: Path | None,
    remap: list[str] | None,
    *,
    overwrite: bool,
) -> None:
    """Write a copy of a source with faults."""
    from sfr_loc_map.faults.kinds import parse_fault
    from sfr_loc_map.faults.source import faulty
    from sfr_loc_map.io.convert import EXACT, convert
    from sfr_loc_map.io.registry import open_source

    if not fault:
        raise ConfigError(f"no --fault given: name at least one of {', '.join(FAULT_KINDS)}")
    faults = [parse_fault(text) for text in fault]
    opened = open_source(source, announced_config(source, config, remap))
    total = sum(len(part) for part in (opened.loc, opened.nav) if part is not None)
    room = output_folder(destination, overwrite=overwrite, inputs=(source,))
    with room as place, naming(source), pairs_progress("injecting faults", total) as progress:
        count = convert(faulty(opened, faults, seed), place, EXACT, progress)
    say(f"{count} of {total} pairs: {destination}", err=True)
    name = destination.stem  # not estimate.csv, which often exists for the source without the fault
    words = ("localise", destination, "-o", f"{name}.csv", "--stats", f"{name}.stats.csv")
    propose("sfr", *words, why="the effect of the fault")
