"""Fuzzing of every file format: `make fuzz`.

Each input is a valid file with one to three mutations. An input fails if the process crashes, hangs, grows, shows a
traceback or "fault of the program", exits with a code outside 0 to 3, or writes control characters or very long lines.
Failed inputs are stored with the command that reproduces the failure. The inputs depend only on the seed.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import time
from pathlib import Path

os.environ["OPENCV_LOG_LEVEL"] = "SILENT"  # for the valid files only; the workers show all messages

from campaigns.fuzz.inputs import Campaign, run_input
from campaigns.fuzz.targets import all_targets, make_world


def main(arguments: list[str]) -> int:
    """Run the campaign, or one input; return the exit code."""
    faulthandler.enable()
    targets = all_targets()
    parser = argparse.ArgumentParser("fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--inputs", type=int, default=2000, help="total number of inputs, with the formats in turn (2000)"
    )
    parser.add_argument("--seconds", type=float, default=600.0, help="no input begins after this time (600)")
    parser.add_argument("--seed", type=int, default=1, help="random seed (1)")
    parser.add_argument("--workers", type=int, default=2, help="number of processes (2)")
    parser.add_argument(
        "--only", action="append", choices=targets, metavar="FORMAT", help="fuzz only this format; repeatable (all)"
    )
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder of failed inputs (out/fuzz)")
    parser.add_argument("--again", nargs=2, metavar=("FORMAT", "FILE"), help="run a single stored input")
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
