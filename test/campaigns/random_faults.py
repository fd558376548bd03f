"""Search for silent errors of the localiser on many drives with random faults (`make random-faults`).

    python -m campaigns random-faults COUNT SEED SRC...

Each source runs once without faults. Then COUNT runs inject random faults into random parts of at most 100 pairs. Each
drive has a row of output. The exit code is 1 if a drive has a silent error.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from sfr_loc_map.bench.fault_benchmark import ErrorReport, StatedErrors, stated_errors
from sfr_loc_map.faults.kinds import FaultKind, parse_fault
from sfr_loc_map.faults.source import FaultyLoc
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.runs.drive_start import start_pose
from sfr_loc_map.runs.localiser_run import localise

MAX_PAIRS = 100
AMOUNTS = {
    FaultKind.BODY: (0.1, 0.4),
    FaultKind.OBJECT: (0.1, 0.4),
    FaultKind.ARM: (0.1, 0.4),
    FaultKind.TEXTURE: (0.1, 0.6),
    FaultKind.SHADOW: (0.1, 0.3),
    FaultKind.DIRT: (0.03, 0.2),
    FaultKind.REFLECTION: (0.2, 0.6),
    FaultKind.SCRATCH: (0.05, 0.3),
    FaultKind.ROLL: (0.05, 0.2),
    FaultKind.PITCH: (0.03, 0.1),
    FaultKind.YAW: (0.01, 0.5),
    FaultKind.DRIFT: (0.05, 0.4),
    FaultKind.SHIFT: (-3.0, 3.0),
    FaultKind.SHEAR: (0.3, 3.0),
    FaultKind.BLURRED: (1.0, 5.0),
    FaultKind.BLINDED: (0.3, 1.5),
    FaultKind.EXPOSURE: (0.3, 1.8),
    FaultKind.SATURATION: (0.2, 0.9),
    FaultKind.FADE: (0.0, 0.0),
    FaultKind.NOISY: (5.0, 30.0),
    FaultKind.START: (1.0, 10.0),
    FaultKind.BLACK: (0.0, 0.0),
    FaultKind.FROZEN: (0.0, 3.0),
    FaultKind.TORN: (0.2, 0.8),
    FaultKind.GHOST: (0.3, 0.7),
    FaultKind.INTERLACED: (0.0, 0.0),
    FaultKind.REPEATED: (0.0, 0.0),
    FaultKind.IDENTICAL: (0.0, 0.0),
    FaultKind.SWAPPED: (0.0, 0.0),
    FaultKind.DROPPED: (0.0, 0.0),
}
"""Ranges of the amounts by kind, in the order from the scene to the receiver: view, lens, exposure, transfer.

Wrong stamps are excluded because they do not affect poses, and a wrong focal length or baseline because it is
unobservable.
"""
COUNTS = (0.6, 0.3, 0.1)  #: Probabilities of one, two and three simultaneous faults.
ROTATIONS = (FaultKind.ROLL, FaultKind.PITCH, FaultKind.YAW, FaultKind.DRIFT)
WHOLE_DRIVE = (*("body", "dirt", "shadow", "texture", "reflection", "scratch", "shift", "start"), *ROTATIONS)


def random_faults(rng: np.random.Generator, pairs: int) -> str:
    """Return one to three faults for a number of pairs, joined by `+`, in physical order."""
    count = 1 + int(rng.choice(len(COUNTS), p=COUNTS))
    kinds = sorted(rng.choice(len(AMOUNTS), count, replace=False))
    return "+".join(_random_fault(rng, list(AMOUNTS)[kind], pairs) for kind in kinds)


def _random_fault(rng: np.random.Generator, kind: FaultKind, pairs: int) -> str:
    low, high = AMOUNTS[kind]
    values = []
    if high > 0.0:
        amount = low + (high - low) * float(rng.random())
        if kind in ROTATIONS and rng.random() < 0.5:
            amount = -amount
        values.append(f"amount={round(amount)}" if kind is FaultKind.START else f"amount={amount:.3f}")
    if kind not in WHOLE_DRIVE:
        long = kind in (FaultKind.OBJECT, FaultKind.ARM, FaultKind.FADE)
        burst = int(rng.integers(10, 41)) if long else int(rng.choice((1, 1, 2, 5, 10)))
        start = int(rng.integers(1, max(2, pairs // 2)))
        values += [f"share={0.05 + 0.35 * float(rng.random()):.2f}", f"burst={burst}", f"start={start}"]
    camera = rng.choice(("both", "both", "both", "left", "right"))
    if "camera" in kind.info.options and kind is not FaultKind.INTERLACED and camera != "both":
        values.append(f"camera={camera}")
    return f"{kind}:{','.join(values)}" if values else str(kind)


class Part:
    """Consecutive pairs of a drive, with a ground truth that begins at the first pair."""

    def __init__(self, inner: LocSequence, first: int, count: int) -> None:
        assert inner.ground_truth is not None
        self._inner, self._range, self.rig = inner, (first, first + count), inner.rig
        truth, begin_ns = inner.ground_truth, self.stamps_ns[0]
        kept = truth.stamps_ns >= begin_ns if first else np.ones(len(truth), np.bool_)
        self.ground_truth = Trajectory(truth.stamps_ns[kept], truth.positions[kept], truth.quats_xyzw[kept])

    @property
    def stamps_ns(self) -> Sequence[int]:
        return self._inner.stamps_ns[slice(*self._range)]

    def __len__(self) -> int:
        return self._range[1] - self._range[0]

    def pairs(self) -> Iterator[StereoPair]:
        return islice(self._inner.pairs(), *self._range)


def errors_of(part: Part, faults: str, seed: int) -> StatedErrors:
    drive = FaultyLoc(part, [parse_fault(text) for text in faults.split("+") if text], seed)
    estimates = [estimate for estimate, _ in localise(drive, LocalisationConfig(), start_pose(part, "truth"))]
    return stated_errors(estimates, part.ground_truth)


def main(arguments: list[str]) -> int:
    """Run the drives `COUNT SEED SRC...` and print a row for each drive."""
    count, seed, sources = int(arguments[0]), int(arguments[1]), arguments[2:]
    drives = {source: open_source(Path(source)).loc for source in sources}
    counts: Counter[ErrorReport] = Counter()
    for number in range(-len(sources), count):
        rng, name = np.random.default_rng([seed, max(number, 0)]), sources[number % len(sources)]
        sequence = drives[name]
        assert sequence is not None, f"no drive in {name}"
        pairs = min(len(sequence), MAX_PAIRS) if number >= 0 else len(sequence)
        first = int(rng.integers(0, len(sequence) - pairs + 1))
        faults, fault_seed = (random_faults(rng, pairs), int(rng.integers(2**31))) if number >= 0 else ("", 0)
        errors = errors_of(Part(sequence, first, pairs), faults, fault_seed)
        ratio = max(errors.position_ratio or 0.0, errors.attitude_ratio or 0.0, errors.step_ratio or 0.0)
        states = f"tracking {errors.tracking}, degraded {errors.degraded}, lost {errors.lost}"
        print(f"{errors.error_report:7} {ratio:6.2f}  {states}: {name} {first}: {faults or 'no fault'}", flush=True)
        counts[errors.error_report] += 1
    print(", ".join(f"{error_report} {counts[error_report]}" for error_report in ErrorReport))
    return 1 if counts[ErrorReport.SILENT] else 0
