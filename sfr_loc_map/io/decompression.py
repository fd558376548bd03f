"""Decompression whose output is bounded before memory is taken.

A few kilobytes can stand for gigabytes. What is compressed may become `FREE_BYTES`, or `LARGEST_RATIO` times its own
size where that is more: images and points of real sensors do not compress so well.
"""

from __future__ import annotations

import sys
from pathlib import Path

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

FREE_BYTES = 64 * 2**20
LARGEST_RATIO = 20
READ_BYTES = 2**20


def expansion_limit(compressed: int) -> int:
    """Return how many bytes something may become that is compressed to a number of bytes."""
    return max(FREE_BYTES, LARGEST_RATIO * compressed)


def check_expansion(compressed: int, size: int, what: str) -> None:
    """Check a size that is claimed for something compressed.

    Raises:
        ValueError: If it is larger than `expansion_limit`.
    """
    if size > expansion_limit(compressed):
        raise ValueError(
            f"{what} of {compressed} bytes claims to hold {size}: up to {expansion_limit(compressed)} are read"
        )


def decompress_zstd(data: bytes, size: int | None = None) -> bytes:
    """Return what zstd frames hold.

    Args:
        data: The frames.
        size: How many bytes they are said to hold; None where that is not said.

    Raises:
        ValueError: If they hold or claim too much, or are cut off.
        zstd.ZstdError: If they are broken.
    """
    limit, parts, total, rest = _limit(len(data), size), [], 0, data
    while rest:
        decompressor = zstd.ZstdDecompressor()
        parts.append(decompressor.decompress(rest, max_length=limit - total + 1))
        total += len(parts[-1])
        if total > limit:
            raise ValueError(f"compressed data of {len(data)} bytes holds more than {limit}")
        if not decompressor.eof:
            raise ValueError("compressed data ends within a frame")
        rest = decompressor.unused_data
    return parts[0] if len(parts) == 1 else b"".join(parts)


def decompress_lz4(data: bytes, size: int) -> bytes:
    """Return what an LZ4 frame holds; otherwise as `decompress_zstd`.

    Raises:
        ValueError: If it holds or claims too much, or is cut off.
        RuntimeError: If it is broken.
    """
    limit = _limit(len(data), size)
    decompressor = LZ4FrameDecompressor()
    found = bytes(decompressor.decompress(data, max_length=limit + 1))
    if len(found) > limit:
        raise ValueError(f"compressed data of {len(data)} bytes holds more than {limit}")
    if not decompressor.eof:
        raise ValueError("compressed data ends within a frame")
    return found


def check_zstd_file(path: Path) -> None:
    """Check how much a zstd file holds, without keeping it.

    Raises:
        ValueError: If that is too much.
        OSError: If it cannot be read.
        zstd.ZstdError: If it is broken.
    """
    limit, total = expansion_limit(path.stat().st_size), 0
    with path.open("rb") as raw, zstd.open(raw, "rb") as stream:
        while part := stream.read(READ_BYTES):
            total += len(part)
            if total > limit:
                raise ValueError(f"'{path.name}' holds more than {limit} bytes once decompressed")


def _limit(compressed: int, size: int | None) -> int:
    if size is None:
        return expansion_limit(compressed)
    check_expansion(compressed, size, "compressed data")
    return size
