"""The formats of sources, and their detection by the names of files and folders.

Only a ROS 1 bag is also detected by its first bytes, because other programs use the ending `.bag`.

A folder may have files of several formats: the folder of a drive may also contain a bag with its ground truth, and a
data set folder contains folders of left and right images. `detected_format` states which format has priority.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path

from sfr_loc_map.io.bag.files import is_storage_file, storage_files
from sfr_loc_map.suffixes import suffix_of
from sfr_loc_map.suite_names import IMAGE_ENDINGS, SIDES_OF

PAIR_FILES = tuple(f"{part}/{name}" for part in (".", "loc", "nav") for name in ("pairs.csv", "rig.json"))
"""Files any of which identifies a data set folder."""


class SourceFormat(StrEnum):
    """The format of a source."""

    FOLDER = "sfr"
    BAG = "bag"
    KITTI = "kitti"
    EUROC = "euroc"
    IMAGES = "images"


def detected_format(path: Path) -> SourceFormat | None:
    """Return the format of a path, which is `BAG` for every bag; None if the format is not supported."""
    if not path.is_dir():
        return SourceFormat.BAG if is_storage_file(path) else None
    if (path / "metadata.yaml").exists():
        return SourceFormat.BAG
    if any((path / name).exists() for name in PAIR_FILES):
        return SourceFormat.FOLDER
    if (path / "calib.txt").exists() and any((path / name).is_dir() for name in ("image_0", "image_2")):
        return SourceFormat.KITTI
    if (path / "mav0" / "cam0").is_dir() or (path / "cam0" / "sensor.yaml").exists():
        return SourceFormat.EUROC
    if image_folders(path) is not None:
        return SourceFormat.IMAGES
    is_incomplete_drive = folders_of_sides(path) or (path / "calib.txt").exists() or (path / "mav0").exists()
    if storage_files(path) and not is_incomplete_drive:
        return SourceFormat.BAG
    return None


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag: the folder of a ROS 2 bag, its storage file, or a ROS 1 bag."""
    return detected_format(path) is SourceFormat.BAG


# ---- folders of images


def image_folders(path: Path) -> tuple[Path, Path] | None:
    """Return the folders of the left and the right images in a folder; None without such folders."""
    return next((sides for sides in folders_of_sides(path) if all(any(images_in(side)) for side in sides)), None)


def folders_of_sides(path: Path) -> list[tuple[Path, Path]]:
    """Return the pairs of folders in a folder that have names of `SIDES_OF`, in this order."""
    folders = {item.name.lower(): item for item in path.iterdir() if item.is_dir()}
    return [(folders[left], folders[right]) for left, right in SIDES_OF if left in folders and right in folders]


def images_in(folder: Path) -> Iterator[Path]:
    """Yield the images in a folder or in its folder `data`, without hidden files (`._NAME.png` of macOS)."""
    inner = folder / "data"
    for file in (inner if inner.is_dir() else folder).iterdir():
        if suffix_of(file) in IMAGE_ENDINGS and not file.name.startswith("."):
            yield file
