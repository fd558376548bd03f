"""Suffixes of file names, which state a format. Upper and lower case have the same meaning."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import PurePath

from sfr_loc_map.errors import OutputError
from sfr_loc_map.message_text import alternatives

FILES = (
    *(".ply", ".pcd", ".npz", ".npy", ".las", ".laz", ".xyz", ".pts", ".obj", ".stl", ".e57"),
    *(".csv", ".txt", ".tum", ".kitti", ".tsv", ".xlsx", ".parquet", ".json", ".yaml", ".yml", ".xml", ".html", ".pdf"),
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pgm", ".mp4", ".avi", ".h5", ".mat", ".bag", ".mcap", ".db3"),
    *(".gz", ".zip", ".tar", ".tgz", ".bz2", ".xz", ".zst", ".7z"),
)
"""Suffixes of well-known files, which the name of a folder rarely has."""

HTML_SUFFIXES = (".html", ".htm")  #: Suffixes of a page.


def check_is_folder_name(path: PurePath, files: str) -> None:
    """Raise OutputError if the name of an output folder has the suffix of a file; `files` are the supported files."""
    suffix = suffix_of(path)
    if suffix in FILES:
        raise OutputError(
            f"cannot write '{path}': no file that ends in {suffix} is written here; give the name of a folder, or of "
            f"{files}"
        )


def suffix_of(path: PurePath) -> str:
    """Return the suffix of a name in lower case, such as `.csv`; empty for a name without a suffix."""
    return path.suffix.lower()


def check_suffix(path: PurePath, suffixes: Collection[str]) -> None:
    """Raise OutputError if the name of an output does not end in one of the suffixes, which are in lower case."""
    if suffix_of(path) not in suffixes:
        raise OutputError(f"cannot write '{path}': a name that ends in {alternatives(suffixes)} is required")
