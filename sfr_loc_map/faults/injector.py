"""Applies faults to a sequence of stereo pairs: selects the affected pairs and changes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.faults import images, views
from sfr_loc_map.faults.affected import Affected
from sfr_loc_map.faults.images import following_stamp, stamp_with_fault
from sfr_loc_map.faults.kinds import Fault, FaultKind
from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

REPEATING = (FaultKind.REPEATED, FaultKind.FROZEN)  #: Kinds that show the images of a previous pair.
UNAFFECTED = -1  #: Burst start of a pair without a fault.

Change = Callable[[Affected], StereoPair]  #: Returns the pair with the fault.
CHANGES: dict[FaultKind, Change] = {
    FaultKind.DROPPED: images.unchanged,
    FaultKind.REPEATED: images.repeated,
    FaultKind.SWAPPED: images.swapped,
    FaultKind.IDENTICAL: images.identical,
    FaultKind.FROZEN: partial(images.with_previous, images.frozen),
    FaultKind.TORN: partial(images.with_previous, images.torn),
    FaultKind.GHOST: partial(images.with_previous, images.ghost),
    FaultKind.INTERLACED: partial(images.with_previous, images.interlaced),
    FaultKind.BLACK: partial(images.each_image, images.black),
    FaultKind.START: partial(images.each_image, images.black),
    FaultKind.FADE: partial(images.each_image, images.faded),
    FaultKind.BLINDED: partial(images.each_image, images.blinded),
    FaultKind.SATURATION: partial(images.each_image, images.saturated),
    FaultKind.LATE: images.with_stamp,
    FaultKind.BLURRED: partial(images.each_image, images.blurred),
    FaultKind.NOISY: partial(images.each_image, images.noisy),
    FaultKind.EXPOSURE: partial(images.each_image, images.exposed),
    FaultKind.SHEAR: partial(images.each_image, images.sheared),
    FaultKind.BODY: partial(views.in_view, views.with_body),
    FaultKind.OBJECT: partial(views.in_view, views.with_object),
    FaultKind.ARM: partial(views.in_view, views.with_arm),
    FaultKind.TEXTURE: partial(views.in_view, views.with_texture),
    FaultKind.REFLECTION: partial(views.in_view, views.with_reflection),
    FaultKind.SCRATCH: partial(views.in_view, views.with_scratches),
    FaultKind.DIRT: partial(views.in_view, views.with_dirt),
    FaultKind.SHADOW: partial(views.in_view, views.with_shadow),
    FaultKind.FOCAL: images.unchanged,
    FaultKind.BASELINE: images.unchanged,
    FaultKind.ROLL: partial(images.right_camera_rotated, 2, 1.0),
    FaultKind.PITCH: partial(images.right_camera_rotated, 0, -1.0),
    FaultKind.YAW: partial(images.right_camera_rotated, 1, -1.0),
    FaultKind.DRIFT: images.drifting,
    FaultKind.SHIFT: images.shifted,
    FaultKind.CLOCK: images.with_stamp,
}
"""Function of each kind that changes an affected pair."""


class FaultInjector:
    """Applies faults to a sequence of a known length; the same seed gives the same result."""

    def __init__(self, faults: Sequence[Fault], seed: int, count: int, rig: StereoRig) -> None:
        """Select the affected pairs of `count` pairs; faults are applied in order, and `rig` is the true rig."""
        self._faults, self._seed, self._true_rig, self._count = tuple(faults), seed, rig, count
        self._bursts = [burst_starts(fault, np.random.default_rng([seed, k]), count) for k, fault in enumerate(faults)]
        self.kept: Mask = np.ones(count, bool)
        for fault, bursts in zip(faults, self._bursts, strict=True):
            self.kept &= (bursts < 0) | (fault.kind is not FaultKind.DROPPED)

    @property
    def rig(self) -> StereoRig:
        """The rig with the faults of the calibration."""
        rig = self._true_rig
        for fault in self._faults:
            if fault.kind is FaultKind.FOCAL:
                rig = replace(rig, fx=rig.fx * fault.amount, fy=rig.fy * fault.amount)
            elif fault.kind is FaultKind.BASELINE:
                rig = replace(rig, baseline_m=rig.baseline_m * fault.amount)
        return rig

    def stamps_ns(self, stamps_ns: Sequence[int]) -> list[int]:
        """Return the stamps of the pairs that `pairs` yields, from the stamps of the source."""
        found: list[int] = []
        for index, (stamp_ns, following_ns) in enumerate(pairwise((*stamps_ns, None))):
            if stamp_ns is None or not self.kept[index]:
                continue
            for fault, bursts in zip(self._faults, self._bursts, strict=True):
                if bursts[index] != UNAFFECTED:
                    stamp_ns = stamp_with_fault(fault, stamp_ns, following_ns)
                following_ns = following_stamp(fault, following_ns)
            found.append(stamp_ns)
        return found

    def pairs(self, pairs: Iterable[StereoPair]) -> Iterator[tuple[int, StereoPair]]:
        """Yield the remaining pairs with their indices in the source.

        Repeated images keep the faults that precede the repetition in the order of the faults.
        """
        previous: list[StereoPair] = []
        for index, (pair, following) in enumerate(pairwise(chain(pairs, (None,)))):
            if pair is None or not self.kept[index]:
                continue
            stages = [pair]  # the input of each fault, then the final pair
            following_ns = None if following is None else following.stamp_ns
            for number, fault in enumerate(self._faults):
                earlier = previous[number] if previous else None
                stages.append(self._with_fault(number, index, stages[-1], earlier, following_ns))
                following_ns = following_stamp(fault, following_ns)
            yield index, stages[-1]
            # consecutive repetitions repeat the last new images
            repeats = (f.kind in REPEATING and b[index] >= 0 for f, b in zip(self._faults, self._bursts, strict=True))
            if not any(repeats):
                previous = stages

    def _with_fault(
        self, number: int, index: int, pair: StereoPair, previous: StereoPair | None, following_ns: int | None
    ) -> StereoPair:
        """Return the pair `index` with the fault `number`.

        `pair` and `previous`, the last earlier pair that is not a repetition, have only the faults that precede it.
        """
        fault = self._faults[number]
        first = int(self._bursts[number][index])
        if first == UNAFFECTED:
            return pair
        pair_rng = np.random.default_rng([self._seed, number, index])
        affected = Affected(
            fault=fault,
            pair=pair,
            previous=previous,
            following_ns=following_ns,
            rig=self._true_rig,
            index=index,
            progress=(index - first + 0.5) / fault.burst,
            spot=pair_rng.random(2),
            pair_rng=pair_rng,
            # the number of pairs is not the index of a pair, so that this seed differs from those of the pairs
            drive_rng=np.random.default_rng([self._seed, number, self._count]),
        )
        return CHANGES[fault.kind](affected)


def burst_starts(fault: Fault, rng: np.random.Generator, count: int) -> NDArray[np.intp]:
    """Return for each pair `(count,)` the first pair of its burst, or -1.

    Bursts are drawn until the share is reached. Complete bursts may exceed the share. Other bursts are shortened to the
    share.
    """
    starts = np.full(count, UNAFFECTED)
    if fault.kind is FaultKind.START:
        starts[: max(round(fault.amount), 0)] = 0
        return starts
    if "share" not in fault.kind.info.options:  # all pairs are affected
        return np.zeros_like(starts)
    candidates = np.arange(min(fault.start, count), count)
    wanted = round(fault.share * len(candidates))
    if fault.kind.info.has_complete_bursts and wanted > 0:
        wanted = max(wanted, min(fault.burst, len(candidates)))
    for first in rng.permutation(candidates):
        room = wanted - int(np.count_nonzero(starts >= 0))
        if room <= 0:
            break
        burst = slice(first, first + min(fault.burst, room))
        if fault.kind.info.has_complete_bursts:
            burst = slice(first, first + fault.burst)
            if first + min(fault.burst, len(candidates)) > count or (starts[burst] >= 0).any():
                continue
        starts[burst] = first
    return starts
