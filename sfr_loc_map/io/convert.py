"""Conversion of sources to bags, folders and layouts of other data sets, and conversion of trajectories and clouds."""

from __future__ import annotations

import heapq
import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.bag.writer import STORAGE_BY_SUFFIX, BagWriter
from sfr_loc_map.io.clouds.cloud_file import load_cloud, save_cloud, save_points
from sfr_loc_map.io.layouts.euroc import EurocWriter
from sfr_loc_map.io.layouts.folder import FolderWriter
from sfr_loc_map.io.layouts.kitti import KittiWriter
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.tables.trajectory_writer import FILE_SUFFIXES, format_of_name, save_trajectory
from sfr_loc_map.message_text import alternatives, counted
from sfr_loc_map.suffixes import check_is_folder_name, suffix_of

SourceWriter = BagWriter | FolderWriter | KittiWriter | EurocWriter
Event = tuple[int, bool, Callable[..., None], tuple[Any, ...]]
"""Stamp (ns), whether the event is a pair, and the function that writes the event with its arguments."""

_log = logging.getLogger(__name__)


class Layout(StrEnum):
    """Layouts of other data sets that a drive can be written in."""

    KITTI = "kitti"
    EUROC = "euroc"


@dataclass(frozen=True, slots=True)
class ConvertOptions:
    """The layout of the output, and options that apply only to bags, because folders are always written exactly."""

    jpeg_quality: int | None = None  # JPEG quality of images, 1 to 100; None: raw and exact
    zstd: bool = False  # chunks are compressed (mcap only)
    truth_grid_m: float | None = None  # true points are rounded to multiples of this power of two, m; None: exact
    layout: Layout | None = None  # layout of another data set; None: a bag, or a folder of the suite


EXACT = ConvertOptions()


def convert(
    source: Source, destination: Path, options: ConvertOptions = EXACT, progress: Callable[[int], None] = lambda _: None
) -> int:
    """Write a source as a ROS 2 bag (*.mcap, *.db3, *.bag) or as a data set folder, and return the number of pairs.

    The output path must not exist or must be an empty folder; the output appears there only when it is complete.
    The layout of another data set holds only the drive. `progress` is called with the number of pairs written so far.
    InputError if the source cannot be read, or has no drive for another layout; OutputError if the output cannot be
    written.
    """
    destination = Path(destination)
    if suffix_of(destination) not in STORAGE_BY_SUFFIX:
        check_is_folder_name(destination, f"a bag ({alternatives(STORAGE_BY_SUFFIX)})")
    if destination.exists() and not destination.is_dir():
        raise OutputError(f"cannot write '{destination}': a file exists there; remove it or choose another name")
    if options.layout is not None:
        if source.loc is None:
            raise OutputError(f"'{source.path}' has no drive, but the layout of {options.layout} contains only a drive")
        source = replace(source, nav=None)
    count = 0
    with atomic_path(destination) as temporary, _writer(temporary, source, options) as writer:
        for _, is_pair, write, values in heapq.merge(*_streams(source, writer), key=lambda event: event[0]):
            write(*values)
            count += is_pair
            progress(count)
    return count


def convert_trajectory(trajectory: Trajectory, destination: Path) -> int:
    """Write a trajectory as csv, TUM, KITTI, EuRoC, bag or folder, by the ending, and return the number of poses.

    In a bag the topic is `ground_truth/odometry`. A warning reports the properties of a `Truth` that are not written.
    """
    destination = Path(destination)
    if isinstance(trajectory, Truth):
        _warn_of_lost_properties(trajectory)
    if format_of_name(destination) is not None:
        save_trajectory(destination, trajectory)
    elif suffix_of(destination) in STORAGE_BY_SUFFIX:
        storage = STORAGE_BY_SUFFIX[suffix_of(destination)]
        with atomic_path(destination) as temporary, BagWriter(temporary, storage) as writer:
            for _, _, write, values in _truth_events(trajectory, writer):
                write(*values)
    else:
        check_is_folder_name(destination, f"a bag or a table ({alternatives((*STORAGE_BY_SUFFIX, *FILE_SUFFIXES))})")
        with atomic_path(destination) as temporary:
            temporary.mkdir()
            save_trajectory(temporary / "groundtruth.csv", trajectory)
    return len(trajectory)


def _writer(path: Path, source: Source, options: ConvertOptions) -> AbstractContextManager[SourceWriter]:
    storage, layout = STORAGE_BY_SUFFIX.get(suffix_of(path)), options.layout
    if storage is not None and layout is None:
        quality, grid_m = options.jpeg_quality, options.truth_grid_m
        return BagWriter(path, storage, jpeg_quality=quality, zstd=options.zstd, truth_grid_m=grid_m)
    if storage is not None:
        raise OutputError(
            f"'{path.name}' is the name of a bag, but '--to {layout}' writes a folder: give the name of a folder, or "
            "omit '--to' to write a bag"
        )
    if replace(options, layout=None) != EXACT:
        raise OutputError(
            f"'{path.name}' is a data set folder, which is always lossless: omit the options for JPEG, zstd and the "
            "grid of the truth, which apply only to bags"
        )
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
            _warn_of_lost_properties(loc.ground_truth)
            streams.append(_truth_events(loc.ground_truth, writer))
        streams.append((pair.stamp_ns, True, writer.write_loc_pair, (pair,)) for pair in loc.pairs())
    if (nav := source.nav) is not None:
        writer.write_nav_rig(nav.rig)
        streams.append((item.pair.stamp_ns, True, writer.write_nav_pair, (item,)) for item in nav.pairs())
    return streams


def _warn_of_lost_properties(truth: Truth) -> None:
    """Warn of a tracked body, accuracies and unknown components of a truth, because no format has them."""
    if any(truth.lever_arm_m):
        _log.warning(
            f"the true positions are those of a body at {list(truth.lever_arm_m)} m in the frame of the rover (RB), "
            "and are written without this lever arm: read the output with the same truth.lever_arm_m"
        )
    accuracies = {"truth.sigma_m": truth.sigma_m, "truth.sigma_deg": truth.sigma_deg}
    lost: dict[str, float | str] = {name: sigma for name, sigma in accuracies.items() if sigma}
    if not (truth.has_height and truth.has_tilt):
        both = "planar" if not (truth.has_height or truth.has_tilt) else ""
        lost["truth.unknown"] = both or ("tilt" if truth.has_height else "height")
    if lost:
        settings = " and ".join(f"{name}={value}" for name, value in lost.items())
        _log.warning(
            "the output cannot declare the accuracy or the unknown components of the truth: read the output with "
            f"{settings}"
        )


def _truth_events(truth: Trajectory, writer: SourceWriter) -> Iterator[Event]:
    for pose in zip(truth.stamps_ns.tolist(), truth.positions, truth.quats_xyzw, strict=True):
        yield pose[0], False, writer.write_truth, pose


def convert_cloud(source: Path, destination: Path) -> int:
    """Write a cloud in another format, and return the number of points; without pixels, only positions are written."""
    loaded = load_cloud(source)
    if loaded.not_finite:
        _log.warning(
            f"cloud '{source}': {counted(loaded.not_finite, 'point')} with a coordinate that is not finite omitted"
        )
    if loaded.cloud is not None:
        save_cloud(destination, loaded.cloud)
    else:
        _log.warning(f"the points of '{source}' have no pixels: only their positions are written")
        save_points(destination, loaded.xyz)
    return len(loaded.xyz)
