"""The median of a few hundred numbers, to the last digit numpy's and several times as fast."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray


def median(values: FloatArray) -> float:
    """Return the median of numbers `(N,)`, none of them NaN; NaN without any."""
    count = len(values)
    if count == 0:
        return float("nan")
    half = count // 2
    if count % 2:
        return float(np.partition(values, half)[half])
    ordered = np.partition(values, (half - 1, half))
    return float((ordered[half - 1] + ordered[half]) / 2.0)


def finite_median(values: FloatArray) -> float:
    """Return the median of those that are not NaN; NaN without any."""
    return median(values[~np.isnan(values)])
