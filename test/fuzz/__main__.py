"""Fuzzing of every file format and message: `python test/fuzz`, see `--help`.

Each input is a valid file with some mutations. It fails if the process ends, hangs, grows, shows a traceback or "fault
of the program", ends with another exit code than 0 to 3, or writes control characters or endless lines. What failed is
kept as a file beside the command that repeats it alone. The inputs depend on the seed alone.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

os.environ["OPENCV_LOG_LEVEL"] = "SILENT"  # of what writes the valid files; the workers hear everything

from campaign import MAX_CPU_S, MAX_GROWTH, Campaign, Summary, again
from targets import all_targets
from world import make_world


def report(summary: Summary, seconds: float) -> None:
    width = max(map(len, summary.by_target), default=0)
    for name, counts in sorted(summary.by_target.items()):
        print(f"{name:{width}}  {'  '.join(f'{kind} {count}' for kind, count in sorted(counts.items()))}")
    print(f"{sum(counts.total() for counts in summary.by_target.values())} inputs in {seconds:.0f} s")
    print(
        f"largest growth {summary.growth_bytes / 1e6:.0f} MB (limit {MAX_GROWTH / 1e6:.0f}), "
        f"longest {summary.seconds:.1f} s of the processor (limit {MAX_CPU_S:.0f})"
    )
    for failure in summary.failures:
        print(f"FAILED {failure.outcome.kind}: {failure.command}")


def main() -> int:
    """Run the campaign, or one input; return the exit code."""
    parser = argparse.ArgumentParser("fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=2000, help="inputs in all, of all formats in turn (2000)")
    parser.add_argument("--seconds", type=float, default=600.0, help="no input begins after this time (600)")
    parser.add_argument("--seed", type=int, default=1, help="of all chance (1)")
    parser.add_argument("--workers", type=int, default=2, help="processes (2)")
    parser.add_argument("--only", action="append", help="a format; repeatable (all)")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder of what failed (out/fuzz)")
    parser.add_argument("--again", nargs=2, metavar=("FORMAT", "FILE"), help="run one kept input alone")
    parser.add_argument("--list", action="store_true", help="list the formats")
    options = parser.parse_args()
    targets = all_targets()
    if options.list:
        print("\n".join(targets))
        return 0
    unknown = [name for name in options.only or () if name not in targets]
    if unknown:
        raise SystemExit(f"there is no format '{unknown[0]}': see --list")
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    world = make_world(out / "world")
    if options.again:
        outcome = again(world, options.again[0], Path(options.again[1]), out)
        print(f"{outcome.kind}, {outcome.seconds:.1f} s, {outcome.growth_bytes / 1e6:.0f} MB\n{outcome.text}")
        return int(not outcome.good)
    begin = time.monotonic()
    campaign = Campaign(world, out / str(options.seed), options.seed, options.workers)
    summary = campaign.run(options.only or list(targets), options.inputs, options.seconds)
    report(summary, time.monotonic() - begin)
    return int(bool(summary.failures))


if __name__ == "__main__":
    raise SystemExit(main())
