"""Fuzzing of every file format: `make fuzz`.

Each input is a valid file with some mutations. It fails if the process ends, hangs, grows, shows a traceback or "fault
of the program", ends with another exit code than 0 to 3, or writes control characters or endless lines. What failed is
kept as a file beside the command that repeats it alone. The inputs depend on the seed alone.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import time
from pathlib import Path

os.environ["OPENCV_LOG_LEVEL"] = "SILENT"  # of what writes the valid files; the workers hear everything

from campaigns.fuzz.inputs import Campaign, run_input
from campaigns.fuzz.targets import all_targets, make_world


def main(arguments: list[str]) -> int:
    """Run the campaign, or one input; return the exit code."""
    faulthandler.enable()
    targets = all_targets()
    parser = argparse.ArgumentParser("fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=2000, help="inputs in all, of all formats in turn (2000)")
    parser.add_argument("--seconds", type=float, default=600.0, help="no input begins after this time (600)")
    parser.add_argument("--seed", type=int, default=1, help="of all chance (1)")
    parser.add_argument("--workers", type=int, default=2, help="processes (2)")
    parser.add_argument("--only", action="append", choices=targets, metavar="FORMAT", help="a format; repeatable (all)")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder of what failed (out/fuzz)")
    parser.add_argument("--again", nargs=2, metavar=("FORMAT", "FILE"), help="run one kept input alone")
    options = parser.parse_args(arguments)
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    world = make_world(out / "world")
    if options.again:
        name, file = options.again
        outcome = run_input(targets[name], Path(file).read_bytes(), world, out / "again")
        print(f"{outcome.kind}, {outcome.seconds:.1f} s, {outcome.growth_bytes / 1e6:.0f} MB\n{outcome.text}")
        return int(not outcome.good)
    begin = time.monotonic()
    campaign = Campaign(world, out / str(options.seed), options.seed)
    campaign.run(options.only or list(targets), options.inputs, options.seconds, options.workers)
    for (name, kind), count in sorted(campaign.outcomes.items()):
        print(f"{name:20}  {kind} {count}")
    print(f"{campaign.outcomes.total()} inputs in {time.monotonic() - begin:.0f} s")
    return int(bool(campaign.failures))
