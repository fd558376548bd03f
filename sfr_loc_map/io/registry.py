"""Opening of a source, and of a ground truth, of any format."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.configuration.parameters import changed
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.inputs import check_exists, check_regular, refusing
from sfr_loc_map.io.calibration.projections import long_baseline
from sfr_loc_map.io.layouts.euroc import open_euroc
from sfr_loc_map.io.layouts.folder import open_folder
from sfr_loc_map.io.layouts.image_folder import open_image_folder
from sfr_loc_map.io.layouts.kitti import open_kitti
from sfr_loc_map.io.sequence import Source, without_truth
from sfr_loc_map.io.source_config import DEFAULT_SOURCE, SourceConfig, source_config
from sfr_loc_map.io.source_format import SourceFormat, detected_format, folders_of_sides, is_bag
from sfr_loc_map.io.truth.config import TruthConfig
from sfr_loc_map.io.truth.read import truth_of_bag, truth_of_file
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.suffixes import suffix_of
from sfr_loc_map.suite_names import IMAGE_ENDINGS

_log = logging.getLogger(__name__)


def _open_bag(path: Path, config: SourceConfig) -> Source:
    from sfr_loc_map.io.layouts.bag_source import open_bag  # rosbags is imported only for bags

    return open_bag(path, config)


class LayoutReader(NamedTuple):
    """The reader of a layout."""

    open: Callable[[Path, SourceConfig], Source]
    ignored: tuple[str, ...] = ()  #: Beginnings of the settings that the layout ignores.


_ONLY_OF_BAGS = ("topics.", "frames.", "sync.stamps")
"""Beginnings of settings that apply only to bags: topics, frames and times of recording."""
_PAIRS_AND_CALIBRATION = (*_ONLY_OF_BAGS, "sync.", "calibration.")
"""Beginnings of settings that a layout ignores if its files list the stereo pairs and contain the calibration."""
READERS: dict[SourceFormat, LayoutReader] = {
    SourceFormat.BAG: LayoutReader(_open_bag),
    SourceFormat.FOLDER: LayoutReader(open_folder, _PAIRS_AND_CALIBRATION),
    SourceFormat.KITTI: LayoutReader(open_kitti, _PAIRS_AND_CALIBRATION),
    SourceFormat.EUROC: LayoutReader(open_euroc, (*_ONLY_OF_BAGS, "calibration.")),
    SourceFormat.IMAGES: LayoutReader(
        open_image_folder, (*_ONLY_OF_BAGS, "calibration.baseline_m", "calibration.stereo_layout")
    ),
}
"""The readers of all layouts. `source_format.detected_format` determines the layout of a path."""


def open_source(path: Path, config: SourceConfig | None = None) -> Source:
    """Open a source with a configuration, by default the `sfr.yaml` beside the source.

    Each pass over the pairs reopens the files.
    """
    path = Path(path)
    reader = READERS[format_of(path)]
    config = source_config(path) if config is None else config
    _report_ignored_settings(path, config, reader.ignored)
    source = reader.open(path, config)
    _report_long_baselines(source)
    return source


def _report_ignored_settings(path: Path, config: SourceConfig, of_layout: tuple[str, ...]) -> None:
    """Warn of settings without effect; `of_layout`: beginnings of the names of settings that the layout ignores."""
    settings = [f"topics.{name}" for name in config.topics]
    for section in ("frames", "sync", "calibration", "truth"):
        settings += changed(getattr(config, section), f"{section}.")
    without_effect = (*of_layout, *_ignored_of_truth(path, config.truth))
    if ignored := [setting for setting in settings if setting.startswith(without_effect)]:
        names = ", ".join(ignored)
        _log.warning(f"'{path}': settings that do not apply to the files of this source are ignored: {names}")


def _report_long_baselines(source: Source) -> None:
    """Warn of a baseline that exceeds those of rovers, because it may be in another unit, or in squares of a board."""
    for name, sequence in (("localisation", source.loc), ("mapping", source.nav)):
        text = "" if sequence is None else long_baseline(sequence.rig.baseline_m, f"{name} cameras")
        if text:
            _log.warning(f"'{source.path}': {text}")


def _ignored_of_truth(path: Path, truth: TruthConfig) -> tuple[str, ...]:
    """Return the settings of the truth that do not apply to its origin: a bag, a file, or the files of a data set."""
    origin = path if truth.file is None else truth.file
    if is_bag(origin):
        return ("truth.columns",)
    of_bags = ("truth.frame", "truth.stamps")
    return of_bags if origin.is_file() else (*of_bags, "truth.columns")


def check_source_exists(path: Path) -> None:
    """Raise InputError if a source does not exist."""
    check_exists(path, "give a data set folder, a ROS bag, or a sequence of another data set")


def format_of(path: Path) -> SourceFormat:
    """Return `detected_format` of a source; InputError if the path does not exist or has no supported format."""
    check_source_exists(path)
    if path.is_file():
        with refusing(f"'{path}' cannot be read", "give the file itself"):
            check_regular(path)
    if (found_format := detected_format(path)) is not None:
        return found_format
    _check_image_formats(path)
    found = ", ".join(sorted(item.name for item in path.iterdir())[:6]) or "nothing" if path.is_dir() else "a file"
    raise InputError(
        f"'{path}' has no supported format: looked for pairs.csv, loc/, nav/ (data set folder), metadata.yaml, "
        f"*.mcap, *.db3 (ROS 2 bag), *.bag (ROS 1 bag), image_0/ or image_2/ and calib.txt (KITTI), mav0/ (EuRoC), "
        f"left/ and right/ with images (and --calibration FILE); found {found};",
        "give the folder that contains such files",
    )


def _check_image_formats(path: Path) -> None:
    """Raise InputError if a path has folders of left and right images, all of them in other formats."""
    sides = folders_of_sides(path) if path.is_dir() else []
    if sides:
        left, right = sides[0]
        found = sorted({suffix_of(file) for side in (left, right) for file in side.iterdir()} - {""})
        raise InputError(
            f"'{path}' has {left.name.lower()}/ and {right.name.lower()}/ without images that end in "
            f"{alternatives(IMAGE_ENDINGS)}: found {', '.join(found) or 'no file'};",
            "convert the images",
        )


def read_truth(path: Path, config: SourceConfig | None = None) -> Truth:
    """Read the ground truth of a bag, a data set folder or a file of poses; InputError if there is none.

    Stereo pairs are not required, except in a folder whose truth is its own.
    If `config` is None, a folder or a bag is read with the `sfr.yaml` beside it, and a file without a configuration.
    """
    check_source_exists(path)
    if config is None:
        config = source_config(path) if path.is_dir() or is_bag(path) else DEFAULT_SOURCE
    if is_bag(path):
        from sfr_loc_map.io.bag.bag import Bag  # rosbags is imported only for bags

        return truth_of_bag(Bag(path, config.topics), config.truth)
    if path.is_file() or config.truth.source:
        return truth_of_file(path, config.truth)
    found = open_source(path, config).truth
    if found is None:
        raise without_truth(path)
    return found
