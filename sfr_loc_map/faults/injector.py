"""Applies faults to a sequence of stereo pairs: selects the affected pairs and changes them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, tee, zip_longest
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import ConfigError, GeometryError
from sfr_loc_map.faults.images import Affected
from sfr_loc_map.faults.kinds import Fault, Selection
from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

T = TypeVar("T")

UNAFFECTED = -1  #: Burst start of a pair without a fault.


@dataclass(frozen=True, slots=True, eq=False)
class PlannedFault:
    """A fault with the selected pairs of a drive and its random generators.

    The selection, each pair and the drive have random generators of their own, which differ in a number: 0 for the
    selection, the index for a pair, and the number of pairs of the drive for the drive. The first pair has the next
    number, because the selection uses the number 0.
    """

    fault: Fault
    seed: tuple[int, int]  #: Seed of the drive, and number of the fault.
    starts: NDArray[np.intp]  #: `(count,)` first pair of the burst that affects each pair, or `UNAFFECTED`.

    @classmethod
    def of(cls, fault: Fault, seed: tuple[int, int], count: int) -> PlannedFault:
        """Select the affected pairs of `count` pairs."""
        selection_rng = np.random.default_rng([*seed, 0])
        return cls(fault, seed, burst_starts(fault, selection_rng, count))

    def pair_rng(self, index: int) -> np.random.Generator:
        """Return the random generator of a pair."""
        number = len(self.starts) + 1 if index == 0 else index
        return np.random.default_rng([*self.seed, number])

    def drive_rng(self) -> np.random.Generator:
        """Return a random generator that starts at the same state for each pair of the drive."""
        return np.random.default_rng([*self.seed, len(self.starts)])

    def affects(self, index: int) -> bool:
        """Return whether the fault affects a pair."""
        return bool(self.starts[index] != UNAFFECTED)

    def changed_rig(self, rig: StereoRig) -> StereoRig:
        """Return the rig with the fault; ConfigError if the amount is impossible for this rig."""
        try:
            return self.fault.kind.info.rig(rig, self.fault.amount)
        except GeometryError as error:
            raise ConfigError(f"fault '{self.fault.kind}': amount is {self.fault.amount:g}: {error}") from error

    def changed_stamps(self, index: int, stamp_ns: int, following_ns: int | None) -> tuple[int, int | None]:
        """Return the stamps of a pair and of the next pair of the source, from these stamps without the fault.

        The next pair has the fault only if all pairs have it.
        """
        info = self.fault.kind.info
        if self.affects(index):
            stamp_ns = info.stamp(stamp_ns, self.fault.amount, following_ns)
        if following_ns is not None and info.selection is Selection.ALL_PAIRS:
            following_ns = info.stamp(following_ns, self.fault.amount, None)
        return stamp_ns, following_ns

    def changed_pair(self, index: int, pair: StereoPair, previous: StereoPair | None, rig: StereoRig) -> StereoPair:
        """Return a pair with changed images, if the fault affects the pair; `rig` is the true rig.

        `pair` and `previous`, the last earlier pair that is not a repetition, have only the faults before this fault.
        """
        if not self.affects(index):
            return pair
        fault = self.fault
        pair_rng = self.pair_rng(index)
        affected = Affected(
            pair=pair,
            previous=previous,
            rig=rig,
            amount=fault.amount,
            camera=fault.camera,
            index=index,
            start=fault.start,
            progress=(index - int(self.starts[index]) + 0.5) / fault.burst,
            spot=pair_rng.random(2),
            pair_rng=pair_rng,
            drive_rng=self.drive_rng(),
        )
        return fault.kind.info.change(affected)


class FaultInjector:
    """Applies faults to a sequence of a known length; the same seed gives the same result."""

    def __init__(self, faults: Sequence[Fault], seed: int, count: int, rig: StereoRig) -> None:
        """Select the affected pairs of `count` pairs; faults are applied in order, and `rig` is the true rig.

        ConfigError if the amount of a fault of the calibration is impossible for this rig.
        """
        self._true_rig = rig
        self._planned = [PlannedFault.of(fault, (seed, number), count) for number, fault in enumerate(faults)]
        kept = np.ones(count, bool)
        for planned in self._planned:
            rig = planned.changed_rig(rig)
            if planned.fault.kind.info.drops:
                kept &= planned.starts == UNAFFECTED
        self.rig = rig  #: The rig with the faults of the calibration.
        self.kept: Mask = kept  #: `(count,)`, whether each pair is not dropped.

    def stamps_ns(self, stamps_ns: Sequence[int]) -> list[int]:
        """Return the stamps of the pairs that `pairs` yields, from the stamps of the source."""
        found: list[int] = []
        for index, (stamp_ns, following_ns) in enumerate(_with_following(stamps_ns)):
            if not self.kept[index]:
                continue
            for planned in self._planned:
                stamp_ns, following_ns = planned.changed_stamps(index, stamp_ns, following_ns)
            found.append(stamp_ns)
        return found

    def pairs(self, source_pairs: Iterable[StereoPair]) -> Iterator[tuple[int, StereoPair]]:
        """Yield the remaining pairs with their indices in the source.

        Repeated images keep the faults that precede the repetition in the order of the faults.
        """
        previous: list[StereoPair] = []  # the stages of the last pair that is not a repetition
        for index, (pair, following) in enumerate(_with_following(source_pairs)):
            if not self.kept[index]:
                continue
            stages = [pair]  # the input of each fault, then the final pair
            following_ns = None if following is None else following.stamp_ns
            for number, planned in enumerate(self._planned):
                before = previous[number] if previous else None
                changed = planned.changed_pair(index, stages[-1], before, self._true_rig)
                stamp_ns, following_ns = planned.changed_stamps(index, changed.stamp_ns, following_ns)
                stages.append(replace(changed, stamp_ns=stamp_ns))
            yield index, stages[-1]
            # consecutive repetitions repeat the last new images
            if not any(planned.fault.kind.info.repeats and planned.affects(index) for planned in self._planned):
                previous = stages


def _with_following(items: Iterable[T]) -> Iterator[tuple[T, T | None]]:
    """Yield each item with the next item; None after the last."""
    here, ahead = tee(items)
    return zip_longest(here, islice(ahead, 1, None))


def burst_starts(fault: Fault, rng: np.random.Generator, count: int) -> NDArray[np.intp]:
    """Return for each pair `(count,)` the first pair of its burst, or `UNAFFECTED`.

    Bursts are drawn until the share is reached. Complete bursts may exceed the share. Other bursts are shortened to the
    share.
    """
    starts = np.full(count, UNAFFECTED)
    selection = fault.kind.info.selection
    if selection is Selection.ALL_PAIRS:
        return np.zeros_like(starts)
    if selection is Selection.FIRST_PAIRS:
        starts[: round(fault.amount)] = 0
        return starts
    is_complete = selection is Selection.COMPLETE_BURSTS
    candidates = np.arange(min(fault.start, count), count)
    wanted = round(fault.share * len(candidates))
    if is_complete and wanted > 0:
        wanted = max(wanted, min(fault.burst, len(candidates)))
    for first in rng.permutation(candidates):
        room = wanted - int(np.count_nonzero(starts >= 0))
        if room <= 0:
            break
        burst = slice(first, first + min(fault.burst, room))
        if is_complete:
            burst = slice(first, first + fault.burst)
            if first + min(fault.burst, len(candidates)) > count or (starts[burst] >= 0).any():
                continue
        starts[burst] = first
    return starts
