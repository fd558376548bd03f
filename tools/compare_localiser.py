"""Check that the localisers of two checkouts return bit-identical results on many drives.

    .venv/bin/python tools/compare_localiser.py record OUT.json SRC...
    .venv/bin/python tools/compare_localiser.py compare OLD.json NEW.json

`record` runs the localiser of this checkout on each source: without faults, with injected faults, with external poses,
with wheel odometry and with missing pairs. The file has a digest of pose, covariance, step, state, reason and
statistics for each pair of each run. `compare` lists the runs that differ, with the first differing pair, and exits
with 1 if a run differs.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.faults.source import FaultyLoc
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.runs.offline import start_pose

PAIRS = 70  #: Number of pairs of all runs but the plain run.
FAULTS = (
    "body:amount=0.3",
    "object:amount=0.35,share=0.3,burst=25",
    "texture:amount=0.5",
    "reflection:amount=0.5",
    "yaw:amount=0.2",
    "drift:amount=0.3",
    "shear:amount=1.5,share=0.3,burst=5",
    "torn:amount=0.5,share=0.2,burst=2",
    "frozen:amount=2,share=0.2,burst=3,camera=left",
    "ghost:amount=0.5,share=0.3,burst=4",
    "interlaced:share=0.3,burst=2",
    "black:share=0.25,burst=8",
    "black:share=0.1,burst=2+object:amount=0.4,share=0.4,burst=20",
    "repeated:share=0.2,burst=2",
    "swapped:share=0.1,burst=2",
    "identical:share=0.1,burst=1",
    "dropped:share=0.2,burst=3",
    "noisy:amount=20,share=0.4,burst=10",
)
COVARIANCE = np.diag([0.01, 0.02, 0.03, 1e-4, 2e-4, 3e-4])


class Run(NamedTuple):
    """One run: the pairs, and the external inputs of the localiser."""

    drive: LocSequence
    poses: dict[int, StartPose]  #: External pose before the pair of this index.
    with_odometry: bool = False  #: Whether the true motion, 2 % too long, is passed as wheel odometry.
    left_out: frozenset[int] = frozenset()  #: Indices of missing pairs.


def runs(sequence: LocSequence) -> Iterator[tuple[str, Run]]:
    """Yield the runs of a source by name."""
    yield "plain", Run(sequence, {})
    for text in FAULTS:
        yield text, Run(FaultyLoc(sequence, [parse_fault(fault) for fault in text.split("+")], 7), {})
    stamps = [pair.stamp_ns for pair in islice(sequence.pairs(), PAIRS)]
    moved = Transform.from_quat([1.0, 2.0, 0.5], [0.0, 0.0, np.sin(0.2), np.cos(0.2)])
    poses = {
        10: StartPose(moved, COVARIANCE, stamps[5]),  # in the past
        20: StartPose(moved, COVARIANCE, stamps[24]),  # in the future
        30: StartPose(moved, COVARIANCE, stamps[29] - (stamps[29] - stamps[28]) // 3),  # between two pairs
        40: StartPose(moved),  # at the next pair
        50: StartPose(moved, COVARIANCE, stamps[50] + 100 * 10**9),  # of another clock
    }
    yield "poses from outside", Run(sequence, poses)
    black = FaultyLoc(sequence, [parse_fault("black:share=0.2,burst=6")], 3)
    yield "poses from outside, black images", Run(black, poses)
    missing = frozenset({12, 13, 25, 26, 27, 40, 41, 42, 43, 44, 45})
    yield "missing pairs", Run(sequence, {}, left_out=missing)
    yield "missing pairs, wheel odometry", Run(sequence, {}, with_odometry=True, left_out=missing)


def digests(run: Run, whole: bool) -> list[str]:
    """Return a digest of the estimate of each pair of a run."""
    localiser = Localiser(run.drive.rig, LocalisationConfig(), start_pose(run.drive, "truth"))
    found: list[str] = []
    truth, before_ns = run.drive.ground_truth, None
    pairs: Iterator[StereoPair] = run.drive.pairs() if whole else islice(run.drive.pairs(), PAIRS)
    for number, pair in enumerate(pairs):
        if number in run.left_out:
            continue
        if number in run.poses:
            localiser.set_pose(run.poses[number])
        motion = None
        if run.with_odometry and truth is not None and before_ns is not None:
            rows = np.searchsorted(truth.stamps_ns, [before_ns, pair.stamp_ns])
            before, now = (truth.pose(int(min(row, len(truth) - 1))) for row in rows)
            motion = before.inverse() @ now
            motion = Transform(motion.rotation, 1.02 * motion.translation)
        found.append(digest(localiser.process(pair, motion)))
        before_ns = pair.stamp_ns
    return found


def digest(estimate: PoseEstimate) -> str:
    """Return the state and a digest of an estimate."""
    step = estimate.step
    arrays = [estimate.T_ds_rb.matrix, estimate.covariance]
    if step is not None:
        arrays += [step.motion, step.uncertainty, step.noise_before, step.speed_change, np.array([step.seconds])]
    data = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    data += repr((estimate.stamp_ns, estimate.state, estimate.reason, estimate.statistics)).encode()
    return f"{estimate.state.value[:4]} {hashlib.sha256(data).hexdigest()[:16]}"


def record(out: Path, sources: list[str]) -> int:
    """Run the localiser on all sources and write the digests to a file."""
    found: dict[str, list[str]] = {}
    for source in sources:
        sequence = open_source(Path(source)).loc
        if sequence is None:
            raise SystemExit(f"'{source}' has no drive")
        for name, run in runs(sequence):
            key = f"{Path(source).name}: {name}"
            found[key] = digests(run, whole=name == "plain")
            states = {state: sum(text.startswith(state) for text in found[key]) for state in ("trac", "degr", "lost")}
            print(key, states, flush=True)
    out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return 0


def compare(old: Path, new: Path) -> int:
    """Print the runs that differ; return 1 if a run differs."""
    before, after = (json.loads(path.read_text(encoding="utf-8")) for path in (old, new))
    differing = [name for name in sorted(before | after) if before.get(name) != after.get(name)]
    for name in differing:
        pairs = zip(before.get(name, []), after.get(name, []), strict=False)
        first = next((number for number, (one, other) in enumerate(pairs) if one != other), "length")
        count = sum(one != other for one, other in zip(before.get(name, []), after.get(name, []), strict=False))
        print(f"{name}: first at pair {first}, {count} of {len(after.get(name, []))} differ")
    print(f"{len(differing)} of {len(before | after)} runs differ")
    return 1 if differing else 0


if __name__ == "__main__":
    command, first, *rest = sys.argv[1:]
    raise SystemExit(record(Path(first), rest) if command == "record" else compare(Path(first), Path(rest[0])))
