"""Any source, with faults if wanted, as a stream to a ROS 2 bag or a data set folder, of ours or of another layout."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.bag_writer import STORAGE_BY_SUFFIX, BagWriter
from sfr_loc_map.io.euroc import EurocWriter
from sfr_loc_map.io.folder import FolderWriter
from sfr_loc_map.io.kitti import KittiWriter
from sfr_loc_map.io.sequence import LocSequence, NavSequence, Source
from sfr_loc_map.io.trajectory_file import format_of_name, save_trajectory
from sfr_loc_map.simulation.faults import Fault
from sfr_loc_map.simulation.perturber import Perturber

SourceWriter = BagWriter | FolderWriter | KittiWriter | EurocWriter
S = TypeVar("S", LocSequence, NavSequence)
Event = tuple[int, bool, Callable[..., None], tuple[Any, ...]]
"""Stamp, whether it is a pair, what writes it, and of what."""


class Layout(StrEnum):
    """Layouts of other data sets that a drive can be written in."""

    KITTI = "kitti"
    EUROC = "euroc"


@dataclass(frozen=True, slots=True)
class ConvertOptions:
    """How a bag is written; folders are always exact."""

    jpeg_quality: int | None = None  # images as JPEG, 1 to 100; None: raw, exact
    zstd: bool = False  # chunks are compressed (mcap only)
    truth_grid_m: float | None = None  # rounding of true points, a power of two; None: exact
    layout: Layout | None = None  # of another data set; None: a bag, or a data set folder of the suite


EXACT = ConvertOptions()


def convert(
    source: Source, destination: Path, options: ConvertOptions = EXACT, progress: Callable[[int], None] = lambda _: None
) -> int:
    """Write a source as a ROS 2 bag (*.mcap, *.db3, *.bag) or as a data set folder, and return the number of pairs.

    The output, absent or an empty folder before, takes its name only when it is whole. A layout of another data set
    takes the drive alone. `progress` is called with the number of pairs written so far.
    """
    destination = Path(destination)
    if destination.exists() and not destination.is_dir():
        raise OutputError(f"cannot write '{destination}': a file is there; remove it or choose another name")
    if options.layout is not None:
        if source.loc is None:
            raise OutputError(f"'{source.path}' has no drive: the layout of {options.layout} holds nothing else")
        source = replace(source, nav=None)
    count = 0
    with atomic_path(destination) as temporary, _writer(temporary, source, options) as writer:
        for _, is_pair, write, values in heapq.merge(*_streams(source, writer), key=lambda event: event[0]):
            write(*values)
            count += is_pair
            progress(count)
    return count


def convert_trajectory(trajectory: Trajectory, destination: Path) -> int:
    """Write a trajectory, and return the number of poses: csv, TUM, KITTI or EuRoC by the ending, or a bag or a folder.

    The topic of a bag is `ground_truth/odometry`.
    """
    destination = Path(destination)
    if format_of_name(destination) is not None:
        save_trajectory(destination, trajectory)
    elif destination.suffix in STORAGE_BY_SUFFIX:
        storage = STORAGE_BY_SUFFIX[destination.suffix]
        with atomic_path(destination) as temporary, BagWriter(temporary, storage) as writer:
            for _, _, write, values in _truth_events(trajectory, writer):
                write(*values)
    else:
        with atomic_path(destination) as temporary:
            temporary.mkdir()
            save_trajectory(temporary / "groundtruth.csv", trajectory)
    return len(trajectory)


def _writer(path: Path, source: Source, options: ConvertOptions) -> AbstractContextManager[SourceWriter]:
    storage, layout = STORAGE_BY_SUFFIX.get(path.suffix), options.layout
    if storage is not None and layout is None:
        quality, grid_m = options.jpeg_quality, options.truth_grid_m
        return BagWriter(path, storage, jpeg_quality=quality, zstd=options.zstd, truth_grid_m=grid_m)
    if storage is not None:
        raise OutputError(f"'{path.name}' is the name of a bag: '--to {layout}' writes a folder")
    if replace(options, layout=None) != EXACT:
        raise OutputError(f"'{path.name}' will be a data set folder, which is exact: JPEG, zstd and grid are for bags")
    if layout is Layout.KITTI:
        return KittiWriter(path)
    if layout is Layout.EUROC:
        return EurocWriter(path)
    return FolderWriter(path, loc=source.loc is not None, nav=source.nav is not None)


def _streams(source: Source, writer: SourceWriter) -> list[Iterator[Event]]:
    streams: list[Iterator[Event]] = []
    if (loc := source.loc) is not None:
        writer.write_loc_rig(loc.rig)
        if loc.ground_truth is not None:
            streams.append(_truth_events(loc.ground_truth, writer))
        streams.append((pair.stamp_ns, True, writer.write_loc_pair, (pair,)) for pair in loc.pairs())
    if (nav := source.nav) is not None:
        writer.write_nav_rig(nav.rig)
        streams.append((item.pair.stamp_ns, True, writer.write_nav_pair, (item,)) for item in nav.pairs())
    return streams


def _truth_events(truth: Trajectory, writer: SourceWriter) -> Iterator[Event]:
    for pose in zip(truth.stamps_ns.tolist(), truth.positions, truth.quats_xyzw, strict=True):
        yield pose[0], False, writer.write_truth, pose


# ---- faults


def faulty(source: Source, faults: Sequence[Fault], seed: int = 0) -> Source:
    """Return a source with injected faults, made as it is read; itself where there is none."""
    if not faults:
        return source
    loc = None if source.loc is None else FaultyLoc(source.loc, faults, seed)
    nav = None if source.nav is None else FaultyNav(source.nav, faults, seed + 1)
    for part in (loc, nav):
        if part is not None and len(part) == 0:
            raise InputError(f"the faults leave no pair of '{source.path}': give a smaller share of 'dropped'")
    return Source(source.path, source.format, loc, nav)


class _Faulty(Generic[S]):
    """Pairs with injected faults; the same seed affects the same ones."""

    def __init__(self, inner: S, faults: Sequence[Fault], seed: int) -> None:
        self._inner: S = inner
        self._perturber = Perturber(faults, seed, len(inner), inner.rig)
        self.rig = self._perturber.rig

    def __len__(self) -> int:
        return int(np.count_nonzero(self._perturber.kept))


class FaultyLoc(_Faulty[LocSequence]):
    """A drive with injected faults; a `LocSequence` with the ground truth of the drive without."""

    @property
    def stamps_ns(self) -> Sequence[int]:
        """Stamps of the pairs that the faults leave."""
        return [int(stamp) for stamp in np.asarray(self._inner.stamps_ns)[self._perturber.kept]]

    @property
    def ground_truth(self) -> Trajectory | None:
        """Ground truth of the drive."""
        return self._inner.ground_truth

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs with their faults."""
        for _, pair in self._perturber.pairs(self._inner.pairs()):
            yield pair


class FaultyNav(_Faulty[NavSequence]):
    """Mapping pairs with injected faults; a `NavSequence` with the poses and the truth of the pairs without."""

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs with their faults."""
        items = list(self._inner.pairs())  # of a map, so they are few
        for index, pair in self._perturber.pairs(item.pair for item in items):
            yield replace(items[index], pair=pair)
