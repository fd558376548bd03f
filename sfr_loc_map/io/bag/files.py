"""Detection of bags and of unfinished files, without importing rosbags."""

from __future__ import annotations

import re
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import check_exists, check_regular, read_text, refusing

STORAGE_SUFFIXES = (".mcap", ".db3")
ROS1_MAGIC = b"#ROSBAG"
ROS1_SUFFIXES = (".bag", ".active")  #: Endings of finished files, and of the files of a recorder that was killed.
MCAP_MAGIC = b"\x89MCAP0\r\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  #: Magic number of a Zstandard frame (RFC 8878, 3.1.1).


def is_bag(path: Path) -> bool:
    """Return whether a path looks like a bag: the folder of a ROS 2 bag, its storage file, or a ROS 1 bag."""
    if path.is_dir():
        parts = ("metadata.yaml", *(f"*{suffix}" for suffix in STORAGE_SUFFIXES))
        return any(True for part in parts for _ in path.glob(part))
    return path.suffix in STORAGE_SUFFIXES or (path.suffix in ROS1_SUFFIXES and is_ros1_bag(path))


def is_ros1_bag(path: Path) -> bool:
    """Return whether a path is a ROS 1 bag by its ending and first bytes; for an empty file, by its ending alone."""
    return path.suffix in ROS1_SUFFIXES and path.is_file() and _ends(path, len(ROS1_MAGIC))[0] in (ROS1_MAGIC, b"")


def _ends(path: Path, count: int) -> tuple[bytes | None, bytes]:
    """Return the first and the last bytes of a file; `(None, b"")` if it cannot be read."""
    try:
        with path.open("rb") as stream:
            first = stream.read(count)
            stream.seek(max(path.stat().st_size - count, 0))
            return first, stream.read()
    except OSError:
        return None, b""


def reader_paths(path: Path) -> list[Path]:
    """Return the paths to open: the folder, or its storage files if rosbags would reject the folder."""
    check_exists(path, "give the folder of a bag, or its .mcap, .db3 or .bag file")
    files = [path]
    if path.is_dir():
        files = [file for suffix in STORAGE_SUFFIXES for file in path.glob(f"*{suffix}")]
        files.sort(key=_by_number)
    for file in files:
        with refusing(f"bag '{file}' cannot be read", "give a .mcap, .db3 or .bag file"):
            check_regular(file)
    metadata = path / "metadata.yaml"
    if not path.is_dir() or (metadata.exists() and not (files and _is_mixed(metadata))):
        return [path]
    if not files:
        raise InputError(f"folder '{path}' is not a bag: it contains neither metadata.yaml nor a .mcap or .db3 file")
    return files


def unnamed_files(folder: Path) -> list[str]:
    """Return the storage files in the folder of a bag that its metadata.yaml does not name."""
    text = read_text(folder / "metadata.yaml")
    stored = sorted(file.name for suffix in STORAGE_SUFFIXES for file in folder.glob(f"*{suffix}"))
    return [name for name in stored if name not in text]


def _by_number(file: Path) -> list[tuple[int, str]]:
    """Return the sort key of a file of a split bag: `bag_2` comes before `bag_10`."""
    parts = re.split(r"([0-9]+)", file.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _is_mixed(metadata: Path) -> bool:
    """Return whether a bag has encodings other than ROS 2, for which rosbags rejects the folder but not the files."""
    with refusing(f"bag '{metadata.parent}' cannot be read", "it is corrupt or truncated: record or copy it again"):
        text = read_text(metadata)
    formats = re.findall(r"^ *serialization_format: *[\"']?(\w*)", text, re.MULTILINE)
    return not {"cdr", ""}.issuperset(formats)


def is_unfinished(path: Path) -> bool:
    """Return whether a file is an MCAP file that was not closed."""
    first, last = _ends(path, len(MCAP_MAGIC))
    return first == MCAP_MAGIC and (last != MCAP_MAGIC or path.stat().st_size == len(MCAP_MAGIC))
