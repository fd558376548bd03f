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
"""Names in the folders that the suite writes: data sets and bags."""
SOURCE_NAMES = DATA_SET_NAMES | {"mav0", "calib.txt", "times.txt", "poses.txt", *(f"image_{n}" for n in range(4))}
"""Names in the folders of all sources."""
NAMES_IN_PATHS = SOURCE_NAMES - {"loc", "nav"}
"""Names in the paths of the files of a source: such a path contains one of these, or begins with a folder of a camera
(`SIDES_OF`)."""
CAMERA_FOLDERS = {name for sides in SIDES_OF for name in sides}


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
