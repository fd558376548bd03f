"""Record the results of localiser and mapper on sources, and compare two records: `make record`, `make compare`.

    .venv/bin/python tools/compare.py record BEFORE.json sample/sample.mcap SRC...
    .venv/bin/python tools/compare.py compare BEFORE.json AFTER.json
    .venv/bin/python tools/compare.py time OTHER_TREE SRC...

`record` writes a digest of every output (`localiser_outputs.py`, `mapper_outputs.py`) and the accuracy of the maps. A
refactoring must not change any digest. Digests depend on the processor, so both records must be made on the same
machine. `compare` prints the outputs that differ, and exits with 1 if an output differs.

`time` maps the sources alternately by this tree and by another tree, each time in a new process. The command prints the
medians of the process time of each call and of the peak memory, and their ratios.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import localiser_outputs
import mapper_outputs
from sfr_loc_map.io.registry import open_source

ROUNDS = 9  #: Number of processes of each tree that `time` starts.
SHOWN = 4  #: Maximum number of printed names of a run.


def record(path: Path, sources: Sequence[Path]) -> None:
    """Write the digests and the accuracies of all sources."""
    digests: dict[str, Any] = {}
    accuracy: dict[str, Any] = {}
    for source in sources:
        drive = open_source(source).loc
        if drive is not None:
            for run, of_run in localiser_outputs.outputs_of(drive):
                digests[f"{source.name}, localiser, {run}"] = of_run
                print(f"{source.name}, localiser, {run}", flush=True)
        of_mapper, figures = mapper_outputs.outputs_of(source)
        digests |= {f"{source.name}, mapper, {variant}": found for variant, found in of_mapper.items()}
        accuracy |= {f"{source.name}, {pair}": found for pair, found in figures.items()}
    path.write_text(json.dumps({"digests": digests, "accuracy": accuracy}, indent=1), encoding="utf-8")


def compare(before: Path, after: Path) -> int:
    """Print the differences of two records; return 1 if an output differs."""
    old, new = (json.loads(path.read_text(encoding="utf-8")) for path in (before, after))
    count = 0
    for run in sorted(old["digests"] | new["digests"]):
        one, other = (record["digests"].get(run, {}) for record in (old, new))
        changed = [name for name in one | other if one.get(name) != other.get(name)]
        count += bool(changed)
        if changed:
            print(f"{run}: {len(changed)} of {len(one | other)} outputs differ: {', '.join(changed[:SHOWN])}")
    for pair, figures in old["accuracy"].items():
        later = new["accuracy"].get(pair, {})
        changed = [name for name, value in figures.items() if later.get(name) != value]
        both = [f"{name} {figures[name]:.4g} -> {later.get(name, float('nan')):.4g}" for name in changed]
        if both:
            print(f"accuracy of {pair}: {', '.join(both)}")
    print(f"{count} of {len(old['digests'] | new['digests'])} runs differ")
    return int(count > 0)


def time_trees(other: Path, sources: Sequence[Path]) -> None:
    """Print the medians of this tree and of another tree, and their ratios."""
    here = Path(__file__).resolve().parents[1]
    taken: dict[Path, list[dict[str, float]]] = {here: [], other.resolve(): []}
    script = f"import json, sys; sys.path.insert(0, {str(here / 'tools')!r}); import mapper_outputs as m\n"
    script += "from pathlib import Path; print(json.dumps(m.measure([Path(p) for p in sys.argv[1:]])))"
    for _ in range(ROUNDS):
        for tree, found in taken.items():
            command = [sys.executable, "-P", "-c", script, *(str(path.resolve()) for path in sources)]
            environment = {**os.environ, "PYTHONPATH": str(tree)}
            done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment, cwd=tree)
            found.append(json.loads(done.stdout))
    for name in taken[here][0]:
        new, old = (statistics.median(run[name] for run in taken[tree]) for tree in taken)
        print(f"{name}: {new:.3f} here, {old:.3f} there, ratio {new / old:.3f}")


def main() -> int:
    """Run the command on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, first in (("record", "output"), ("compare", "before"), ("time", "tree")):
        command = commands.add_parser(name)
        command.add_argument(first, type=Path)
        if name == "compare":
            command.add_argument("after", type=Path)
        else:
            command.add_argument("sources", type=Path, nargs="+")
    options = parser.parse_args()
    if options.command == "compare":
        return compare(options.before, options.after)
    if options.command == "record":
        record(options.output, options.sources)
    else:
        time_trees(options.tree, options.sources)
    return 0


if __name__ == "__main__":
    sys.exit(main())
