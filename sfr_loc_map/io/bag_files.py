"""The files of a bag: how it is detected, and which of them a reader opens."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import check_regular
from sfr_loc_map.io.sqlite_check import check_whole

if TYPE_CHECKING:
    from sfr_loc_map.io.mcap_recovery import RecoveringReader
    from sfr_loc_map.io.ros1_bag import Ros1Reader

STORAGE_SUFFIXES = (".mcap", ".db3")
ROS1_MAGIC = b"#ROSBAG"
ROS1_SUFFIXES = (".bag", ".active")
"""Endings of files: finished ones, and those of a recorder that was killed."""
BagReader: TypeAlias = "RecoveringReader | Ros1Reader"


def is_bag(path: Path) -> bool:
    """Tell whether a path looks like a bag: the folder of a ROS 2 bag, its storage file, or a ROS 1 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").exists() or bool(_storage_files(path))
    return path.suffix in STORAGE_SUFFIXES or is_ros1_bag(path)


def is_ros1_bag(path: Path) -> bool:
    """Tell whether a path is a file of a ROS 1 bag, by its first bytes; an empty file by its ending."""
    if path.suffix not in ROS1_SUFFIXES or not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            return stream.read(len(ROS1_MAGIC)) in (ROS1_MAGIC, b"")
    except OSError:
        return False


def reader_of(file: Path) -> BagReader:
    """Return what reads a file or folder of `reader_paths`; only then the library of the bags is loaded."""
    if is_ros1_bag(file):
        from sfr_loc_map.io.ros1_bag import Ros1Reader

        return Ros1Reader(file)
    from sfr_loc_map.io.mcap_recovery import RecoveringReader

    return RecoveringReader(file)


def reader_paths(path: Path) -> list[Path]:
    """Return what readers shall open: the folder, or the storage files where metadata.yaml is missing.

    Raises:
        InputError: If there is no bag, or one of its files is none or broken beyond reading.
    """
    if not path.exists():
        raise InputError(f"there is no bag '{path}': give its folder or its .mcap, .db3 or .bag file")
    files = _storage_files(path) if path.is_dir() else [path]
    for file in files:
        _require_regular(file)
        if file.suffix == ".db3":
            check_whole(file)
    if not path.is_dir() or (path / "metadata.yaml").exists():
        return [path]
    if not files:
        raise InputError(f"folder '{path}' is not a bag: neither metadata.yaml nor a .mcap or .db3 file is in it")
    return files


def _storage_files(folder: Path) -> list[Path]:
    return sorted(file for suffix in STORAGE_SUFFIXES for file in folder.glob(f"*{suffix}"))


def _require_regular(file: Path) -> None:
    try:
        check_regular(file)
    except OSError as error:
        raise InputError(f"bag '{file}' cannot be read: {error.strerror}; give a .mcap, .db3 or .bag file") from error
