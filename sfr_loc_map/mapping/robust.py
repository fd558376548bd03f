"""Robust statistics."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.median import median

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal law over its median absolute deviation."""


def mad_sigma(deviations: NDArray[np.floating[Any]]) -> float:
    """Return the robust standard deviation of deviations from the centre, `1.4826 median |e|`."""
    return MAD_TO_SIGMA * median(np.abs(deviations))
