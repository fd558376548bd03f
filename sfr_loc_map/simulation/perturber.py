"""Applies injected faults to a sequence of stereo pairs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.simulation.faults import RIG_KINDS, Fault, FaultKind
from sfr_loc_map.simulation.image_faults import IMAGE_FAULTS, ROTATION_AXES, Moment, rotated, with_noise
from sfr_loc_map.simulation.view_faults import VIEW_FAULTS, faulty_view

ALL_PAIRS = (*RIG_KINDS, *ROTATION_AXES, FaultKind.CLOCK)
"""Kinds that affect all pairs."""
EPISODES = (FaultKind.FADE, FaultKind.OBJECT)
"""Kinds whose bursts are whole: one begins only where it can end."""
DRIFT_PAIRS = 100.0
UNAFFECTED = -1
LAST_STAMP_NS = 2**63 - 1


class Perturber:
    """Applies faults to a sequence of a known length; the same seed affects the same pairs in the same way."""

    def __init__(self, faults: Sequence[Fault], seed: int, count: int, rig: StereoRig) -> None:
        """Choose the affected pairs.

        Args:
            faults: Applied in this order.
            seed: Seed of the choice and of noise.
            count: Number of pairs.
            rig: True rig.
        """
        self._faults, self._seed, self._true_rig, self._count = tuple(faults), seed, rig, count
        self._bursts = [burst_starts(fault, np.random.default_rng([seed, k]), count) for k, fault in enumerate(faults)]
        gone = [
            bursts >= 0 for fault, bursts in zip(faults, self._bursts, strict=True) if fault.kind is FaultKind.DROPPED
        ]
        self.kept: Mask = ~np.any(gone, axis=0) if gone else np.ones(count, bool)

    @property
    def rig(self) -> StereoRig:
        """The rig of the faulty calibration."""
        rig = self._true_rig
        for fault in self._faults:
            if fault.kind is FaultKind.FOCAL:
                rig = replace(rig, fx=rig.fx * fault.amount, fy=rig.fy * fault.amount)
            elif fault.kind is FaultKind.BASELINE:
                rig = replace(rig, baseline_m=rig.baseline_m * fault.amount)
        return rig

    def pairs(self, pairs: Iterable[StereoPair]) -> Iterator[tuple[int, StereoPair]]:
        """Yield the pairs that are left, each with its number in the source."""
        previous: list[StereoPair] = []
        for index, (pair, following) in enumerate(_with_next(pairs)):
            if not self.kept[index]:
                continue
            stages = self._stages(index, pair, previous, following)
            yield index, stages[-1]
            if not self._repeats(index):  # also repeated twice running, the last new images are repeated
                previous = stages

    def _repeats(self, index: int) -> bool:
        faults = zip(self._faults, self._bursts, strict=True)
        kinds = (FaultKind.REPEATED, FaultKind.FROZEN)
        return any(fault.kind in kinds and bursts[index] >= 0 for fault, bursts in faults)

    def _stages(
        self, index: int, pair: StereoPair, previous: Sequence[StereoPair], following: StereoPair | None
    ) -> list[StereoPair]:
        """Return a pair as each fault finds it, then as it is delivered.

        A fault that shows old images shows them as it found them: with the faults before it, which they had then.

        Args:
            index: Number of the pair.
            pair: The pair without faults.
            previous: The same of the last new pair; empty at the first.
            following: The next pair.
        """
        stages = [pair]
        for number, fault in enumerate(self._faults):
            old = previous[number] if previous else None
            pair = self._perturbed(index, number, fault, pair, (old, following))
            stages.append(pair)
        return stages

    def _perturbed(
        self,
        index: int,
        number: int,
        fault: Fault,
        pair: StereoPair,
        beside: tuple[StereoPair | None, StereoPair | None],
    ) -> StereoPair:
        """Return a pair with one fault more; `beside` are the last new pair, as the fault found it, and the next."""
        previous, following = beside
        first = int(self._bursts[number][index])
        if first == UNAFFECTED:
            return pair
        rng = np.random.default_rng([self._seed, number, index])
        moment = Moment((index - first + 0.5) / fault.burst, rng.random(2), rng)
        if fault.kind in (FaultKind.LATE, FaultKind.CLOCK):
            return _late(pair, fault, following)
        if fault.kind in (FaultKind.YAW, FaultKind.PITCH, FaultKind.ROLL, FaultKind.DRIFT):
            share = (index - fault.start) / DRIFT_PAIRS if fault.kind is FaultKind.DRIFT else 1.0
            angle_deg = fault.amount * max(share, 0.0)
            return replace(pair, right=rotated(pair.right, fault.kind, angle_deg, self._true_rig))
        if fault.kind in VIEW_FAULTS:
            return faulty_view(pair, fault, moment, self._true_rig, [self._seed, number, self._count])
        if fault.kind in IMAGE_FAULTS:
            return _degraded(pair, fault, moment)
        return _mixed_up(pair, previous, fault, moment)


def burst_starts(fault: Fault, rng: np.random.Generator, count: int) -> NDArray[np.intp]:
    """Return for each pair `(count,)` the first pair of the burst that affects it; -1 where none does.

    Bursts are chosen at random until the share is reached.
    """
    starts = np.full(count, UNAFFECTED)
    if fault.kind in ALL_PAIRS:
        return np.zeros_like(starts)
    if fault.kind is FaultKind.START:
        starts[: max(round(fault.amount), 0)] = 0
        return starts
    candidates = np.arange(min(fault.start, count), count)
    wanted = round(fault.share * len(candidates))
    if fault.kind in EPISODES and wanted > 0:
        wanted = max(wanted, min(fault.burst, len(candidates)))
    for first in rng.permutation(candidates):
        room = wanted - int(np.count_nonzero(starts >= 0))
        if room <= 0:
            break
        burst = slice(first, first + min(fault.burst, room))
        if fault.kind in EPISODES:
            burst = slice(first, first + fault.burst)
            if first + min(fault.burst, len(candidates)) > count or (starts[burst] >= 0).any():
                continue
        starts[burst] = first
    return starts


def _late(pair: StereoPair, fault: Fault, following: StereoPair | None) -> StereoPair:
    stamp_ns = pair.stamp_ns + round(fault.amount * NS_PER_S)
    if fault.kind is FaultKind.LATE:
        stamp_ns = min(stamp_ns, following.stamp_ns - 1 if following is not None else LAST_STAMP_NS)
    return replace(pair, stamp_ns=stamp_ns)


def _degraded(pair: StereoPair, fault: Fault, moment: Moment) -> StereoPair:
    degrade = IMAGE_FAULTS[fault.kind]
    left = pair.left if fault.camera == "right" else degrade(pair.left, fault.amount, moment)
    right = pair.right if fault.camera == "left" else degrade(pair.right, fault.amount, moment)
    return StereoPair(pair.stamp_ns, left, right)


def _mixed_up(pair: StereoPair, previous: StereoPair | None, fault: Fault, moment: Moment) -> StereoPair:
    """Return a pair with images of another camera or of a pair before."""
    left, right = pair.left, pair.right
    if fault.kind is FaultKind.SWAPPED:
        left, right = right, left
    elif fault.kind is FaultKind.IDENTICAL:
        right = left
    elif previous is not None:
        if fault.kind is FaultKind.REPEATED:
            return StereoPair(pair.stamp_ns, previous.left, previous.right)
        olds = (previous.left, previous.right)
        if fault.kind is FaultKind.FROZEN:
            both = [with_noise(old.astype(np.float32), fault.amount, moment.rng) for old in olds]
        else:
            rows = round((1.0 - fault.amount) * len(left))
            both = [np.vstack((new[:rows], old[rows:])) for new, old in zip((left, right), olds, strict=True)]
        left = left if fault.camera == "right" else both[0]
        right = right if fault.camera == "left" else both[1]
    return StereoPair(pair.stamp_ns, left, right)


def _with_next(pairs: Iterable[StereoPair]) -> Iterator[tuple[StereoPair, StereoPair | None]]:
    iterator = iter(pairs)
    current = next(iterator, None)
    while current is not None:
        following = next(iterator, None)
        yield current, following
        current = following
