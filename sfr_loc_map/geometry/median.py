"""Medians to the last digit numpy's and many times as fast: its own looks for three numbers at once, the slow way."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def median(values: NDArray[np.floating[Any]]) -> float:
    """Return the median of numbers of any shape, none of them NaN; NaN without any."""
    count = values.size
    if count == 0:
        return float("nan")
    half = count // 2
    ordered = np.partition(values.reshape(-1), half)
    if count % 2:
        return float(ordered[half])
    return float((ordered[:half].max() + ordered[half]) / 2.0)


def finite_median(values: NDArray[np.floating[Any]]) -> float:
    """Return the median of those that are not NaN; NaN without any."""
    return median(values[~np.isnan(values)])
