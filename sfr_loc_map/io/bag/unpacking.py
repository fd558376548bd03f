"""Decompression with bounds: data of another program cannot take any amount of memory."""

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
    """Return what compressed frames hold; `new` makes a decompressor of one, `size` is how many bytes are announced."""
    most = expansion_limit(len(data))
    if size is not None and size > most:  # before memory is taken
        raise ValueError(f"compressed data of {len(data)} bytes claims to contain {size}: up to {most} are read")
    limit = most if size is None else size
    parts: list[bytes] = []
    total = 0
    rest = data
    while rest:
        decompressor = new()
        parts.append(bytes(decompressor.decompress(rest, max_length=limit - total + 1)))
        total += len(parts[-1])
        if total > limit:
            raise ValueError(f"compressed data of {len(data)} bytes holds more than {limit}")
        if not decompressor.eof:
            raise ValueError("compressed data ends within a frame")
        rest = decompressor.unused_data
    return parts[0] if len(parts) == 1 else b"".join(parts)


def unpack_bz2(data: bytes) -> bytes:
    """Return what bzip2 frames hold."""
    return unpack(data, bz2.BZ2Decompressor)


def unpack_lz4(data: bytes, size: int | None = None) -> bytes:
    """Return what LZ4 frames hold."""
    return unpack(data, LZ4FrameDecompressor, size)


def unpack_zstd(data: bytes, size: int | None = None) -> bytes:
    """Return what Zstandard frames hold."""
    return unpack(data, zstd.ZstdDecompressor, size)


def check_zstd_file(path: Path) -> None:
    """Check how much a Zstandard file holds, without keeping it."""
    limit = expansion_limit(path.stat().st_size)
    total = 0
    with path.open("rb") as raw, zstd.open(raw, "rb") as stream:
        while part := stream.read(2**20):
            total += len(part)
            if total > limit:
                raise ValueError(f"'{path.name}' holds more than {limit} bytes once decompressed")
