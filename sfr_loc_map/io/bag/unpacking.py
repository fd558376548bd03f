"""Decompression with size limits, so that malformed data cannot exhaust the memory."""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from sfr_loc_map.inputs import expansion_limit

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd


def unpack(data: bytes, new: Callable[[], Any], size: int | None = None) -> bytes:
    """Decompress frames.

    `new` creates a decompressor for one frame; `size` is the declared decompressed size, bytes.
    """
    most = expansion_limit(len(data))
    if size is not None and size > most:  # before memory is allocated
        raise ValueError(
            f"compressed data of {len(data)} bytes declares {size} bytes of content: at most {most} are allowed"
        )
    limit = most if size is None else size
    parts: list[bytes] = []
    total = 0
    rest = data
    while rest:
        decompressor = new()
        parts.append(bytes(decompressor.decompress(rest, max_length=limit - total + 1)))
        total += len(parts[-1])
        if total > limit:
            raise ValueError(f"compressed data of {len(data)} bytes exceeds {limit} bytes when decompressed")
        if not decompressor.eof:
            raise ValueError("compressed data ends within a frame")
        rest = decompressor.unused_data
    return parts[0] if len(parts) == 1 else b"".join(parts)


def unpack_bz2(data: bytes) -> bytes:
    """Decompress bzip2 frames."""
    return unpack(data, bz2.BZ2Decompressor)


def unpack_lz4(data: bytes, size: int | None = None) -> bytes:
    """Decompress LZ4 frames."""
    return unpack(data, LZ4FrameDecompressor, size)


def unpack_zstd(data: bytes, size: int | None = None) -> bytes:
    """Decompress Zstandard frames."""
    return unpack(data, zstd.ZstdDecompressor, size)


def unpack_zstd_file(path: Path, folder: Path) -> Path:
    """Decompress a Zstandard file to a file without its suffix in a folder; raise ValueError if it is too large."""
    unpacked = folder / path.stem
    limit = expansion_limit(path.stat().st_size)
    total = 0
    with path.open("rb") as raw, zstd.open(raw, "rb") as stream, unpacked.open("wb") as output:
        while part := stream.read(2**20):
            total += len(part)
            if total > limit:
                raise ValueError(f"'{path.name}' exceeds {limit} bytes when decompressed")
            output.write(part)
    return unpacked
