"""Records of a point cloud file as columns."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = dict[str, NDArray[Any]]
"""Values of each field, one a point."""
FUSED_COMMENT = "sfr fused"
"""Comment of PLY and PCD files that says whether the cloud is fused; `true` or `false` follows."""


@dataclass(frozen=True, slots=True, eq=False)
class CloudRecords:
    """What a cloud file holds.

    Attributes:
        columns: Values of each field.
        fused: Whether the cloud is fused, None where the file does not say so.
    """

    columns: Columns
    fused: bool | None = None


def fused_comments(cloud_fused: bool | None) -> list[str]:
    """Return the comments of a cloud file, without the format's sign of a comment: none where it is not known."""
    return [] if cloud_fused is None else [f"{FUSED_COMMENT} {str(cloud_fused).lower()}"]


def fused_by_comments(comments: Iterable[str]) -> bool | None:
    """Return whether a cloud is fused by the comments of its file, None where none says so.

    Raises:
        ValueError: If one says neither `true` nor `false`, or two differ.
    """
    said = {text[len(FUSED_COMMENT) :].strip() for text in comments if text.startswith(FUSED_COMMENT + " ")}
    if not said:
        return None
    if len(said) > 1 or not said <= {"true", "false"}:
        raise ValueError(f"its comment '{FUSED_COMMENT} {' '.join(sorted(said))}' must end in true or false")
    return said == {"true"}


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
    if count:
        table = np.loadtxt(io.BytesIO(body), np.float64, ndmin=2, max_rows=count)
    if table.shape != (count, sum(widths)):
        raise ValueError(f"{table.shape} numbers found where {(count, sum(widths))} are needed")
    starts = np.cumsum([0, *widths])
    return {name: table[:, starts[i]] for i, name in enumerate(names) if widths[i] == 1}


def _binary_columns(body: bytes, dtype: np.dtype[Any], count: int) -> Columns:
    if len(body) < count * dtype.itemsize:
        raise ValueError(f"{len(body)} bytes found where {count} points of {dtype.itemsize} bytes are needed")
    records = np.frombuffer(body, dtype, count)
    return {name: records[name] for name in dtype.names or () if dtype[name].shape == ()}
