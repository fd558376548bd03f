"""Every format that can be read, by name, and the detection of the format of a path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.io.euroc import is_euroc, open_euroc
from sfr_loc_map.io.folder import PLACES, open_folder
from sfr_loc_map.io.kitti import is_kitti, open_kitti
from sfr_loc_map.io.sequence import Source

Remap = Mapping[str, str] | None
Opener = Callable[[Path, Remap], Source]


def _open_bag(path: Path, remap: Remap) -> Source:
    from sfr_loc_map.io.bag_sequence import open_bag  # the library of the bags is loaded for a bag only

    return open_bag(path, remap)


READERS: dict[str, tuple[Callable[[Path], bool], Opener]] = {
    "bag": (is_bag, _open_bag),
    "sfr": (lambda path: any((path / place).exists() for place in PLACES), lambda path, _: open_folder(path)),
    "kitti": (is_kitti, lambda path, _: open_kitti(path)),
    "euroc": (is_euroc, lambda path, _: open_euroc(path)),
}
"""Name of a format, its test and opener, in the order of trying; a folder with rig.json or pairs.csv is `sfr`.

Formats of trajectories stand in `trajectory_file.py`, those of clouds in `cloud_file.py`.
"""


def open_source(path: Path, remap: Remap = None) -> Source:
    """Open a source of any format; each pass opens its files itself. `remap`: new names of topics by those in a bag."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"there is no '{path}': give a data set folder, a ROS bag, or a sequence of another data set")
    for matches, opener in READERS.values():
        if matches(path):
            return opener(path, remap)
    found = ", ".join(sorted(item.name for item in path.iterdir())[:6]) or "nothing" if path.is_dir() else "a file"
    raise InputError(
        f"'{path}' is of no format that is read: sought pairs.csv, loc/, nav/ (data set folder), metadata.yaml, "
        f"*.mcap, *.db3 (ROS 2 bag), *.bag (ROS 1 bag), image_0/ and calib.txt (KITTI), mav0/ (EuRoC); found {found}; "
        f"give the folder that holds them"
    )
