"""`sfr perturb`: any source with injected faults."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli import completion
from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import SourceArgument, naming, progress_bar
from sfr_loc_map.cli.next_step import propose
from sfr_loc_map.cli.output import OverwriteOption, output_folder, say
from sfr_loc_map.errors import ConfigError

FAULT_HELP = (
    "KIND, or KIND: and some of amount=A (its unit: docs/simulation.md), share=S of the pairs (0 to 1), burst=N pairs "
    "at a time, start=N (first pair), camera=both|left|right, with commas between; repeatable. Kinds: "
    "dropped, repeated, swapped, identical, frozen, torn; black, start, fade, blinded, saturation, blurred, noisy, "
    "exposure; body, object, dirt, shadow; late, clock; focal, baseline, roll, pitch, yaw, drift."
)


@app.command(
    epilog=examples(
        "sfr perturb data/ faulty/ --fault dropped:share=0.2 --fault blurred:amount=3,camera=left",
        "sfr perturb drive.mcap faulty.mcap --fault body:amount=0.3 --seed 4",
    )
)
def perturb(
    source: SourceArgument,
    destination: Annotated[
        Path, typer.Argument(metavar="DST", help="*.mcap, *.db3 or *.bag: a ROS 2 bag; else a data set folder.")
    ],
    fault: Annotated[
        list[str] | None,
        typer.Option("--fault", metavar="KIND[:...]", help=FAULT_HELP, autocompletion=completion.faults),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed that selects the affected pairs.")] = 0,
    overwrite: OverwriteOption = False,
) -> None:
    """Copy a source and inject faults: of single pairs, of the cameras, of the view, of clock and calibration."""
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.pipeline.perturb import perturb as run
    from sfr_loc_map.simulation.faults import KINDS, parse_fault

    if not fault:
        raise ConfigError(f"no --fault given: name at least one of {', '.join(KINDS)}")
    faults = [parse_fault(text) for text in fault]
    opened = open_source(source, {})
    total = sum(len(part) for part in (opened.loc, opened.nav) if part is not None)
    room = output_folder(destination, overwrite=overwrite, inputs=(source,))
    with room, naming(source), progress_bar("pairs") as bar:
        task = bar.add_task("injecting faults", total=total)
        count = run(opened, destination, faults, seed, lambda done: bar.update(task, completed=done))
    say(f"{count} of {total} pairs: {destination}", err=True)
    name = destination.stem  # of its own: estimate.csv of the source without the fault is often there already
    words = ("localise", destination, "-o", f"{name}.csv", "--stats", f"{name}.stats.csv")
    propose("sfr", *words, why="what the fault does")
