"""Digests of the localiser's estimates on a drive; `compare.py` records and compares them.

The localiser runs without faults, with injected faults, with external poses, with wheel odometry and with missing
pairs. Each digest is of pose, covariance, step, state, reason and statistics of a pair.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.faults.source import FaultyLoc
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.runs.drive_start import start_pose

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


def outputs_of(sequence: LocSequence) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the digests of the pairs of each run, by the name of the run."""
    for name, run in runs(sequence):
        yield name, {f"pair {number}": text for number, text in enumerate(digests(run, whole=name == "plain"))}
