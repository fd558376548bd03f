"""The storage files of bags, also those of unfinished recordings, without importing rosbags."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path, PurePath
from typing import NamedTuple

import msgspec

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import check_exists, check_regular, read_text, refusing
from sfr_loc_map.json_yaml import converted, parse_yaml
from sfr_loc_map.suffixes import suffix_of

METADATA = "rosbag2_bagfile_information"  #: Name of the content of metadata.yaml.
STORAGE_SUFFIXES = (".mcap", ".db3")
ROS1_MAGIC = b"#ROSBAG"
ROS1_SUFFIXES = (".bag", ".active")  #: Endings of finished files, and of the files of a recorder that was killed.
MCAP_MAGIC = b"\x89MCAP0\r\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  #: Magic number of a Zstandard frame (RFC 8878, 3.1.1).


def is_storage_file(path: Path) -> bool:
    """Return whether a path is named as a storage file of a ROS 2 bag, or is a ROS 1 bag."""
    return suffix_of(path) in STORAGE_SUFFIXES or is_ros1_bag(path)


def storage_files(folder: Path) -> list[Path]:
    """Return the storage files in a folder in the order of their numbers."""
    files = (file for file in folder.iterdir() if suffix_of(file) in STORAGE_SUFFIXES and not file.is_dir())
    return sorted(files, key=_by_number)


def is_ros1_bag(path: Path) -> bool:
    """Return whether a path is a ROS 1 bag by its ending and first bytes; for an empty file, by its ending alone."""
    return suffix_of(path) in ROS1_SUFFIXES and path.is_file() and _ends(path, len(ROS1_MAGIC))[0] in (ROS1_MAGIC, b"")


def _ends(path: Path, count: int) -> tuple[bytes | None, bytes]:
    """Return the first and the last bytes of a file; `(None, b"")` if it cannot be read."""
    try:
        with path.open("rb") as stream:
            first = stream.read(count)
            stream.seek(max(path.stat().st_size - count, 0))
            return first, stream.read()
    except OSError:
        return None, b""


class BagFiles(NamedTuple):
    """The storage files of a bag, and what its metadata.yaml states about them."""

    paths: tuple[Path, ...]
    has_metadata: bool = False  #: Whether metadata.yaml, which is written when a recording ends, names the files.
    compression: str = ""  #: `file` or `message`, if all files or all messages are compressed by zstd; else empty.
    message_count: int = 0  #: Number of messages that metadata.yaml states; 0 without metadata.yaml.
    unnamed: tuple[str, ...] = ()  #: Storage files in the folder that metadata.yaml does not name.

    @property
    def are_unfinished(self) -> bool:
        """Whether the recording was not closed: it has no metadata.yaml, and an MCAP file without its end."""
        return not self.has_metadata and any(is_unfinished(file) for file in self.paths)


class _Metadata(msgspec.Struct, frozen=True):
    """The values of metadata.yaml that are used."""

    relative_file_paths: tuple[str, ...]
    compression_mode: str | None = None
    compression_format: str | None = None
    message_count: int = 0


def bag_files(path: Path) -> BagFiles:
    """Return the files of a bag: those that metadata.yaml names, otherwise all storage files of the folder."""
    check_exists(path, "give the folder of a bag, or its .mcap, .db3 or .bag file")
    files = BagFiles((path,))
    if path.is_dir():
        stored = storage_files(path)
        metadata = path / "metadata.yaml"
        files = _files_of_metadata(metadata, stored) if metadata.exists() else BagFiles(tuple(stored))
    if not files.paths:
        raise InputError(f"folder '{path}' is not a bag: it contains neither metadata.yaml nor a .mcap or .db3 file")
    for file in files.paths:
        with refusing(f"bag '{file}' cannot be read", "give a .mcap, .db3 or .bag file"):
            check_regular(file)
    return files


def _files_of_metadata(metadata: Path, stored: Sequence[Path]) -> BagFiles:
    """Return the files that metadata.yaml names; `stored` are the storage files in its folder."""
    folder = metadata.parent
    with refusing(f"bag '{folder}' cannot be read", "it is corrupt or truncated: record or copy it again"):
        about = _parse_metadata(read_text(metadata))
        names = [PurePath(name).name for name in about.relative_file_paths]
        if not names:
            raise InputError(
                f"bag '{folder}': its metadata.yaml does not name the files of the bag:", "run 'ros2 bag reindex'"
            )
        if missing := [name for name in names if not (folder / name).exists()]:
            raise ValueError(f"metadata.yaml names '{missing[0]}', which is missing")
        mode = (about.compression_mode or "none").lower()
        if mode not in ("none", "file", "message") or (mode != "none" and about.compression_format != "zstd"):
            raise InputError(
                f"bag '{folder}': its {mode}s are compressed by '{about.compression_format}', which is not supported:",
                "compress them by zstd, or not at all",
            )
    return BagFiles(
        tuple(folder / name for name in names),
        has_metadata=True,
        compression="" if mode == "none" else mode,
        message_count=about.message_count,
        unnamed=tuple(sorted({file.name for file in stored} - {*names})),
    )


@lru_cache(maxsize=4)  # parsing a text of 4 kB takes 10 ms, and a command opens a bag several times
def _parse_metadata(text: str) -> _Metadata:
    content = parse_yaml(text)
    if not isinstance(content, dict) or METADATA not in content:
        raise ValueError(f"metadata.yaml has no {METADATA}")
    return converted(content[METADATA], _Metadata, METADATA)


def _by_number(file: Path) -> list[tuple[int, str]]:
    """Return the sort key of a file of a split bag: `bag_2` comes before `bag_10`."""
    parts = re.split(r"([0-9]+)", file.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def is_unfinished(path: Path) -> bool:
    """Return whether a file is an MCAP file that was not closed."""
    first, last = _ends(path, len(MCAP_MAGIC))
    return first == MCAP_MAGIC and (last != MCAP_MAGIC or path.stat().st_size == len(MCAP_MAGIC))
