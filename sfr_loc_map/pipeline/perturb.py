"""Injects faults into any source and writes the result as a bag or a folder."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.sequence import LocSequence, NavSequence, Source
from sfr_loc_map.pipeline.convert import ConvertOptions, convert
from sfr_loc_map.simulation.faults import Fault
from sfr_loc_map.simulation.perturber import Perturber


def perturb(
    source: Source,
    destination: Path,
    faults: Sequence[Fault],
    seed: int = 0,
    progress: Callable[[int], None] = lambda _: None,
) -> int:
    """Write a source with injected faults; the ground truth stays that of the source.

    Args:
        source: The source without faults.
        destination: Bag or folder to write.
        faults: Applied in this order to the drive and to the mapping pairs.
        seed: Seed of which pairs are affected.
        progress: Called with the number of pairs written so far.

    Returns:
        The number of pairs written.

    Raises:
        InputError: If the source is broken, or the faults leave no pair.
        OutputError: If the output cannot be written.
    """
    return convert(faulty(source, faults, seed), destination, ConvertOptions(), progress)


def faulty(source: Source, faults: Sequence[Fault], seed: int = 0) -> Source:
    """Return a source with injected faults, made as it is read; the ground truth stays that of the source.

    Args:
        source: The source without faults; itself where there is no fault.
        faults: Applied in this order to the drive and to the mapping pairs.
        seed: Seed of which pairs are affected.

    Raises:
        InputError: If the faults leave no pair.
    """
    if not faults:
        return source
    loc = None if source.loc is None else FaultyLoc(source.loc, faults, seed)
    nav = None if source.nav is None else FaultyNav(source.nav, faults, seed + 1)
    for part in (loc, nav):
        if part is not None and len(part) == 0:
            raise InputError(f"the faults leave no pair of '{source.path}': give a smaller share of 'dropped'")
    return Source(source.path, source.format, loc, nav)


class FaultyLoc:
    """A drive with injected faults; a `LocSequence` with the ground truth of the drive without."""

    def __init__(self, inner: LocSequence, faults: Sequence[Fault], seed: int) -> None:
        """Choose the affected pairs; the same seed affects the same ones."""
        self._inner, self._perturber = inner, Perturber(faults, seed, len(inner), inner.rig)

    @property
    def rig(self) -> StereoRig:
        """The rig of the faulty calibration."""
        return self._perturber.rig

    @property
    def ground_truth(self) -> Trajectory | None:
        """Ground truth of the drive."""
        return self._inner.ground_truth

    def __len__(self) -> int:
        """Return the number of pairs that are left."""
        return int(np.count_nonzero(self._perturber.kept))

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs with their faults."""
        for _, pair in self._perturber.pairs(self._inner.pairs()):
            yield pair


class FaultyNav:
    """Mapping pairs with injected faults; a `NavSequence` with the poses and the truth of the pairs without."""

    def __init__(self, inner: NavSequence, faults: Sequence[Fault], seed: int) -> None:
        """Choose the affected pairs; the same seed affects the same ones."""
        self._inner, self._perturber = inner, Perturber(faults, seed, len(inner), inner.rig)

    @property
    def rig(self) -> StereoRig:
        """The rig of the faulty calibration."""
        return self._perturber.rig

    def __len__(self) -> int:
        """Return the number of pairs that are left."""
        return int(np.count_nonzero(self._perturber.kept))

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs with their faults."""
        read: deque[tuple[int, PosedStereoPair]] = deque()

        def images() -> Iterator[StereoPair]:
            for item in enumerate(self._inner.pairs()):
                read.append(item)
                yield item[1].pair

        for index, pair in self._perturber.pairs(images()):
            while read[0][0] < index:
                read.popleft()
            yield replace(read[0][1], pair=pair)
