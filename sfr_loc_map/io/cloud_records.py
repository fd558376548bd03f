"""Records of a point cloud file as columns."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = dict[str, NDArray[Any]]
"""Values of each field, one a point."""


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
