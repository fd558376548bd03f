"""Whether an SQLite file is all there: some versions of the library read a file that was cut off without a word."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.errors import InputError

MAGIC = b"SQLite format 3\x00"
HEADER_BYTES = 100
LARGEST_PAGE = 65536


def check_whole(path: Path) -> None:
    """Compare the size of a file with what its header says (SQLite's file format, section 1.3); others are left alone.

    Raises:
        InputError: If the file is shorter.
    """
    with path.open("rb") as stream:
        header = stream.read(HEADER_BYTES)
    if len(header) < HEADER_BYTES or not header.startswith(MAGIC) or header[24:28] != header[92:96]:
        return  # not such a file, or the number of pages in it is not kept: the library will tell
    page = int.from_bytes(header[16:18], "big")
    wanted = int.from_bytes(header[28:32], "big") * (LARGEST_PAGE if page == 1 else page)
    size = path.stat().st_size
    if size < wanted:
        raise InputError(f"'{path}' is cut off: {size} of {wanted} bytes are there; copy or record it again")
