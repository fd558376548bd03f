"""A source whose pairs get injected faults while they are read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.faults.injector import FaultInjector
from sfr_loc_map.faults.kinds import Fault
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.io.sequence import LocSequence, NavSequence, Source

S = TypeVar("S", LocSequence, NavSequence)


def faulty(source: Source, faults: Sequence[Fault], seed: int = 0) -> Source:
    """Return a source whose pairs get injected faults while they are read; the source itself if no fault is given."""
    if not faults:
        return source
    loc = None if source.loc is None else FaultyLoc(source.loc, faults, seed)
    nav = None if source.nav is None else FaultyNav(source.nav, faults, seed + 1)
    for part in (loc, nav):
        if part is not None and len(part) == 0:
            raise InputError(f"the faults drop all pairs of '{source.path}': give a smaller share of 'dropped'")
    return replace(source, loc=loc, nav=nav, recorded=None)


class _Faulty(Generic[S]):
    """Pairs with injected faults; the seed determines the affected pairs."""

    def __init__(self, inner: S, faults: Sequence[Fault], seed: int) -> None:
        self._inner: S = inner
        self._injector = FaultInjector(faults, seed, len(inner), inner.rig)
        self.rig = self._injector.rig

    @property
    def stamps_ns(self) -> Sequence[int]:
        """Stamps of the pairs that are not dropped, including the faults of stamps."""
        return self._injector.stamps_ns([int(stamp_ns) for stamp_ns in self._inner.stamps_ns])

    @property
    def missing_ns(self) -> Sequence[int]:
        """Stamps of the missing pairs of the original sequence."""
        return self._inner.missing_ns

    def __len__(self) -> int:
        return int(np.count_nonzero(self._injector.kept))


class FaultyLoc(_Faulty[LocSequence]):
    """A `LocSequence` with injected faults and the ground truth of the original drive."""

    @property
    def ground_truth(self) -> Truth | None:
        """Ground truth of the drive."""
        return self._inner.ground_truth

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs with their faults."""
        for _, pair in self._injector.pairs(self._inner.pairs()):
            yield pair


class FaultyNav(_Faulty[NavSequence]):
    """A `NavSequence` with injected faults and the poses and ground truth of the original pairs."""

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs with their faults."""
        items = list(self._inner.pairs())  # a map has few pairs
        for index, pair in self._injector.pairs(item.pair for item in items):
            yield replace(items[index], pair=pair)
