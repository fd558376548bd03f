"""Names of the files of sources, so that outputs replace neither other files of a folder nor files of an input."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from sfr_loc_map.io.bag.files import STORAGE_SUFFIXES
from sfr_loc_map.suffixes import suffix_of

DATA_SET_NAMES = {
    *("rig.json", "pairs.csv", "groundtruth.csv", "simulation.yaml", "metadata.yaml"),
    *("left", "right", "truth", "masks", "loc", "nav"),
}
"""Names in the folders that the suite writes: data sets and bags."""
SOURCE_NAMES = DATA_SET_NAMES | {"mav0", "calib.txt", "times.txt", "poses.txt", *(f"image_{n}" for n in range(4))}
"""Names in the folders of all sources."""
NAMES_IN_PATHS = SOURCE_NAMES - {"loc", "nav"}  #: The path of each file of a source contains at least one of these.


def has_only_data_set(folder: Path) -> bool:
    """Return whether a folder contains only files and folders of a data set or a bag."""
    return all(item.name in DATA_SET_NAMES or suffix_of(item) in STORAGE_SUFFIXES for item in folder.iterdir())


def source_of_file(path: Path, sources: Iterable[Path]) -> Path | None:
    """Return the folder among `sources` to which a file belongs by its name; None if there is none.

    All paths are resolved.
    """
    for folder in set(sources) & {*path.parents}:
        names = set(path.relative_to(folder).parts)
        if suffix_of(path) in STORAGE_SUFFIXES or names & NAMES_IN_PATHS:
            return folder
    return None
