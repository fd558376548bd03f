"""Records of a point cloud file as columns."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.cloud import PointCloud

Columns = dict[str, NDArray[Any]]
"""Values of each field, one a point."""
FUSED = "fused"
PAIR_STAMPS = "pair_stamps_ns"
"""Names of what a file says of its cloud: comments `sfr fused true`, `sfr pair_stamps_ns 1 2 3`, or members of NPZ."""
_COMMENT = "sfr "
_MAX_STAMP = 2**63
MAX_PAIR_STAMPS = 256
"""As many pairs as the points' `pair` can name."""


@dataclass(frozen=True, slots=True, eq=False)
class CloudRecords:
    """What a cloud file holds.

    Attributes:
        columns: Values of each field.
        fused: Whether the cloud is fused, None where the file does not say so.
        pair_stamps_ns: Stamps of its pairs, None where the file does not say so.
    """

    columns: Columns
    fused: bool | None = None
    pair_stamps_ns: tuple[int, ...] | None = None


def cloud_comments(cloud: PointCloud) -> list[str]:
    """Return what a cloud says of itself, as comments without the format's sign of one."""
    comments = [] if cloud.fused is None else [f"{_COMMENT}{FUSED} {str(cloud.fused).lower()}"]
    if cloud.pair_stamps_ns is not None:
        comments.append(f"{_COMMENT}{PAIR_STAMPS} {' '.join(map(str, cloud.pair_stamps_ns))}")
    return comments


def records_of(columns: Columns, comments: Iterable[str]) -> CloudRecords:
    """Return the records of a file with what its comments say of the cloud.

    Raises:
        ValueError: If a comment says what it cannot, or two differ.
    """
    said: dict[str, str] = {}
    for text in comments:
        name, _, value = text.removeprefix(_COMMENT).partition(" ")
        if text.startswith(_COMMENT) and said.setdefault(name, value.strip()) != value.strip():
            raise ValueError(f"its comments '{_COMMENT}{name}' differ")
    fused, stamps = said.get(FUSED), said.get(PAIR_STAMPS)
    if fused not in (None, "true", "false"):
        raise ValueError(f"its comment '{_COMMENT}{FUSED} {fused}' must end in true or false")
    return CloudRecords(
        columns, None if fused is None else fused == "true", None if stamps is None else _stamps(stamps)
    )


def _stamps(text: str) -> tuple[int, ...]:
    words = text.split()
    if len(words) > MAX_PAIR_STAMPS or not all(
        word.isascii() and word.isdecimal() and len(word) < 20 and int(word) < _MAX_STAMP for word in words
    ):
        raise ValueError(f"its comment '{_COMMENT}{PAIR_STAMPS}' must list whole nanoseconds")
    return tuple(int(word) for word in words)


def columns_of(body: bytes, dtype: np.dtype[Any], count: int, *, is_text: bool) -> Columns:
    """Return the scalar fields of `count` records.

    Args:
        body: The file after its header.
        dtype: Fields of a record.
        count: Number of records.
        is_text: Whether the numbers are written as text, one record a line.

    Raises:
        ValueError: If there are fewer records, or other numbers of values.
    """
    return _text_columns(body, dtype, count) if is_text else _binary_columns(body, dtype, count)


def _text_columns(body: bytes, dtype: np.dtype[Any], count: int) -> Columns:
    names = dtype.names or ()
    widths = [int(np.prod(dtype[name].shape)) for name in names]
    table = np.zeros((0, sum(widths)))
    if len(body) + 1 < 2 * count * sum(widths):  # each number has a digit and an end
        raise ValueError(f"{len(body)} bytes of text found where {count} points of {sum(widths)} numbers are needed")
    if count:
        lines = b"\n".join(line for line in body.splitlines() if line.strip())  # numpy warns of empty ones
        table = np.loadtxt(io.BytesIO(lines), np.float64, ndmin=2, max_rows=count)
    if table.shape != (count, sum(widths)):
        raise ValueError(f"{table.shape} numbers found where {(count, sum(widths))} are needed")
    starts = np.cumsum([0, *widths])
    return {name: table[:, starts[i]] for i, name in enumerate(names) if widths[i] == 1}


def _binary_columns(body: bytes, dtype: np.dtype[Any], count: int) -> Columns:
    if len(body) < count * dtype.itemsize:
        raise ValueError(f"{len(body)} bytes found where {count} points of {dtype.itemsize} bytes are needed")
    records = np.frombuffer(body, dtype, count)
    return {name: records[name] for name in dtype.names or () if dtype[name].shape == ()}
