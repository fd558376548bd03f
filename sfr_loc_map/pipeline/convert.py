"""Any source, with faults if wanted, as a stream to a ROS 2 bag or a data set folder, of ours or of another layout."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Protocol

import numpy as np

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.bag_writer import STORAGE_BY_SUFFIX, BagWriter
from sfr_loc_map.io.euroc import EurocWriter
from sfr_loc_map.io.folder import FolderWriter
from sfr_loc_map.io.kitti import KittiWriter
from sfr_loc_map.io.sequence import LocSequence, NavSequence, Source
from sfr_loc_map.io.trajectory_file import FILE_SUFFIXES, format_of_name, save_trajectory
from sfr_loc_map.simulation.faults import Fault
from sfr_loc_map.simulation.perturber import Perturber


class Layout(StrEnum):
    """Layouts of other data sets that a drive can be written in."""

    KITTI = "kitti"
    EUROC = "euroc"


@dataclass(frozen=True, slots=True)
class ConvertOptions:
    """How a bag is written; folders are always exact.

    Attributes:
        jpeg_quality: Images as JPEG of this quality, 1 to 100; None: raw, exact.
        zstd: Whether chunks are compressed (mcap only).
        truth_grid_m: Rounding of true points, a power of two, metres; None: exact.
        layout: Layout of another data set; None: a bag, or a data set folder of the suite.
    """

    jpeg_quality: int | None = None
    zstd: bool = False
    truth_grid_m: float | None = None
    layout: Layout | None = None

    @property
    def is_exact(self) -> bool:
        """Whether nothing is asked for that only bags have."""
        return self.jpeg_quality is None and not self.zstd and self.truth_grid_m is None


class SourceWriter(Protocol):
    """What takes the parts of a source: a bag or a folder being written."""

    def write_loc_rig(self, rig: StereoRig) -> None:
        """Take the rig of the drive."""
        ...

    def write_nav_rig(self, rig: StereoRig) -> None:
        """Take the rig of the mapping pairs."""
        ...

    def write_loc_pair(self, pair: StereoPair) -> None:
        """Take a pair of the drive."""
        ...

    def write_nav_pair(self, nav: PosedStereoPair) -> None:
        """Take a mapping pair."""
        ...

    def write_truth(self, stamp_ns: int, position: FloatArray, quat_xyzw: FloatArray) -> None:
        """Take a true pose."""
        ...


Event = tuple[int, Callable[[], None], bool]
"""Stamp, what writes it, whether it is a pair."""


def convert(
    source: Source, destination: Path, options: ConvertOptions, progress: Callable[[int], None] = lambda _: None
) -> int:
    """Write a source as a ROS 2 bag (*.mcap, *.db3, *.bag) or as a data set folder (any other name).

    The output takes its name only when it is whole. A layout of another data set takes the drive alone.

    Args:
        source: What to write.
        destination: Where to; must not exist, or be an empty folder.
        options: How.
        progress: Called with the number of pairs written so far.

    Returns:
        The number of pairs.

    Raises:
        InputError: If the source is broken.
        OutputError: If the output cannot be written, or the options do not fit it.
    """
    destination = Path(destination)
    if destination.exists() and not destination.is_dir():
        raise OutputError(f"cannot write '{destination}': a file is there; remove it or choose another name")
    if options.layout is not None:
        source = _drive_alone(source, options.layout)
    with atomic_path(destination) as temporary, _writer(temporary, source, options) as writer:
        return _copy(source, writer, progress)


def is_trajectory(path: Path) -> bool:
    """Tell whether a name is that of a trajectory file that is written (csv, TUM, KITTI, EuRoC)."""
    return format_of_name(path) is not None


def holds_trajectory(path: Path) -> bool:
    """Tell whether a path is a trajectory file that is read: these, and results of evo."""
    return not path.is_dir() and path.suffix in FILE_SUFFIXES


def convert_trajectory(trajectory: Trajectory, destination: Path) -> int:
    """Write a trajectory: as csv, TUM, KITTI or EuRoC by the ending, otherwise to a bag or a folder.

    The topic of a bag is `ground_truth/odometry`.

    Returns:
        The number of poses.

    Raises:
        OutputError: If the output cannot be written.
    """
    destination = Path(destination)
    if is_trajectory(destination):
        save_trajectory(destination, trajectory)
    elif destination.suffix in STORAGE_BY_SUFFIX:
        storage = STORAGE_BY_SUFFIX[destination.suffix]
        with atomic_path(destination) as temporary, BagWriter(temporary, storage) as writer:
            for _, write, _ in _truth_events(trajectory, writer):
                write()
    else:
        with atomic_path(destination) as temporary:
            temporary.mkdir()
            save_trajectory(temporary / "groundtruth.csv", trajectory)
    return len(trajectory)


def _drive_alone(source: Source, layout: Layout) -> Source:
    if source.loc is None:
        raise OutputError(f"'{source.path}' has no drive: the layout of {layout} holds nothing else")
    return replace(source, nav=None)


def _writer(path: Path, source: Source, options: ConvertOptions) -> AbstractContextManager[SourceWriter]:
    storage = STORAGE_BY_SUFFIX.get(path.suffix)
    if storage is not None and options.layout is None:
        return BagWriter(
            path,
            storage,
            jpeg_quality=options.jpeg_quality,
            zstd=options.zstd,
            truth_grid_m=options.truth_grid_m,
        )
    if storage is not None:
        raise OutputError(f"'{path.name}' is the name of a bag: '--to {options.layout}' writes a folder")
    if not options.is_exact:
        raise OutputError(f"'{path.name}' will be a data set folder, which is exact: JPEG, zstd and grid are for bags")
    if options.layout is Layout.KITTI:
        return KittiWriter(path)
    if options.layout is Layout.EUROC:
        return EurocWriter(path)
    return FolderWriter(path, loc=source.loc is not None, nav=source.nav is not None)


def _copy(source: Source, writer: SourceWriter, progress: Callable[[int], None]) -> int:
    count = 0
    streams = []
    if source.loc is not None:
        writer.write_loc_rig(source.loc.rig)
        if source.loc.ground_truth is not None:
            streams.append(_truth_events(source.loc.ground_truth, writer))
        streams.append(_loc_events(source.loc.pairs(), writer))
    if source.nav is not None:
        writer.write_nav_rig(source.nav.rig)
        streams.append(_nav_events(source.nav.pairs(), writer))
    for _, write, is_pair in heapq.merge(*streams, key=lambda event: event[0]):
        write()
        count += is_pair
        progress(count)
    return count


def _loc_events(pairs: Iterator[StereoPair], writer: SourceWriter) -> Iterator[Event]:
    for pair in pairs:
        yield pair.stamp_ns, lambda pair=pair: writer.write_loc_pair(pair), True  # type: ignore[misc]


def _nav_events(pairs: Iterator[PosedStereoPair], writer: SourceWriter) -> Iterator[Event]:
    for nav in pairs:
        yield nav.pair.stamp_ns, lambda nav=nav: writer.write_nav_pair(nav), True  # type: ignore[misc]


def _truth_events(truth: Trajectory, writer: SourceWriter) -> Iterator[Event]:
    for i, stamp_ns in enumerate(truth.stamps_ns.tolist()):
        yield stamp_ns, lambda i=i, s=stamp_ns: writer.write_truth(s, truth.positions[i], truth.quats_xyzw[i]), False  # type: ignore[misc]


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
