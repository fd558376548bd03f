"""The localiser on many drives with random faults: is it ever wrong without saying so? (make random-faults)

    PYTHONPATH=. python test/localisation/random_faults.py COUNT SEED SRC...

Each source runs once without faults, then COUNT random faults on random parts of at most 100 pairs. A row for each
drive; the exit code is 1 if one is silent.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.pipeline.convert import FaultyLoc
from sfr_loc_map.pipeline.offline import localise, start_pose
from sfr_loc_map.simulation.faults import parse_fault, random_faults
from sfr_loc_map.suite.fault_benchmark import Honesty, StatedErrors, stated_errors

MAX_PAIRS = 100


class Part:
    """Consecutive pairs of a drive; its ground truth begins at the first of them."""

    def __init__(self, inner: LocSequence, first: int, count: int) -> None:
        assert inner.ground_truth is not None
        self._inner, self._range, self.rig = inner, (first, first + count), inner.rig
        truth, begin_ns = inner.ground_truth, next(self.pairs()).stamp_ns
        kept = truth.stamps_ns >= begin_ns if first else np.ones(len(truth), np.bool_)
        self.ground_truth = Trajectory(truth.stamps_ns[kept], truth.positions[kept], truth.quats_xyzw[kept])

    def __len__(self) -> int:
        return self._range[1] - self._range[0]

    def pairs(self) -> Iterator[StereoPair]:
        return islice(self._inner.pairs(), *self._range)


def errors_of(part: Part, faults: str, seed: int) -> StatedErrors:
    drive = FaultyLoc(part, [parse_fault(text) for text in faults.split("+") if text], seed)
    estimates = [estimate for estimate, _ in localise(drive, LocalisationConfig(), start_pose(part, "truth"))]
    return stated_errors(estimates, part.ground_truth)


def main(count: int, seed: int, *sources: str) -> int:
    drives = {source: open_source(Path(source)).loc for source in sources}
    counts: Counter[Honesty] = Counter()
    for number in range(-len(sources), count):
        rng, name = np.random.default_rng([seed, max(number, 0)]), sources[number % len(sources)]
        sequence = drives[name]
        assert sequence is not None, f"no drive in {name}"
        pairs = min(len(sequence), MAX_PAIRS) if number >= 0 else len(sequence)
        first = int(rng.integers(0, len(sequence) - pairs + 1))
        faults, fault_seed = (random_faults(rng, pairs), int(rng.integers(2**31))) if number >= 0 else ("", 0)
        errors = errors_of(Part(sequence, first, pairs), faults, fault_seed)
        ratio = max(errors.position_ratio or 0.0, errors.attitude_ratio or 0.0)
        states = f"tracking {errors.tracking}, degraded {errors.degraded}, lost {errors.lost}"
        print(f"{errors.honesty:7} {ratio:6.2f}  {states}: {name} {first}: {faults or 'no fault'}", flush=True)
        counts[errors.honesty] += 1
    print(", ".join(f"{honesty} {counts[honesty]}" for honesty in Honesty))
    return 1 if counts[Honesty.SILENT] else 0


if __name__ == "__main__":
    raise SystemExit(main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]))
