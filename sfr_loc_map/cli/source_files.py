"""Names of the files of sources, so that outputs replace neither other files of a folder nor files of an input."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from sfr_loc_map.io.bag.files import STORAGE_SUFFIXES
from sfr_loc_map.suffixes import suffix_of
from sfr_loc_map.suite_names import SIDES_OF

DATA_SET_NAMES = {
    *("rig.json", "pairs.csv", "groundtruth.csv", "simulation.yaml", "metadata.yaml"),
    *("left", "right", "truth", "masks", "loc", "nav"),
}
"""Files and folders in a data set folder, and `metadata.yaml` of a bag."""
NAMES_IN_PATHS = DATA_SET_NAMES - {"loc", "nav"} | {
    *("mav0", "calib.txt", "times.txt", "poses.txt"),
    *(f"image_{number}" for number in range(4)),
}
"""Files and folders that identify a path as that of a file of a source. `loc` and `nav` alone do not, because these
names are also common outside of data sets."""
CAMERA_FOLDERS = {name for sides in SIDES_OF for name in sides}
"""Folders of images, in lower case. A path that begins with one of these is that of a file of a source."""


def has_only_data_set(folder: Path) -> bool:
    """Return whether a folder contains only files and folders of a data set or a bag."""
    return all(item.name in DATA_SET_NAMES or suffix_of(item) in STORAGE_SUFFIXES for item in folder.iterdir())


def source_of_file(path: Path, sources: Iterable[Path]) -> Path | None:
    """Return the folder among `sources` to which a file belongs by its name; None if there is none.

    All paths are resolved.
    """
    for folder in set(sources) & {*path.parents}:
        names = path.relative_to(folder).parts
        is_named = names[0].lower() in CAMERA_FOLDERS or not NAMES_IN_PATHS.isdisjoint(names)
        if suffix_of(path) in STORAGE_SUFFIXES or is_named:
            return folder
    return None
