"""Check that the configuration of a method under test does not contain the ground truth of the drive."""

from __future__ import annotations

import re

import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY
from sfr_loc_map.geometry.trajectory import Trajectory

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
STRIDES = (1, 4)
"""Index steps from x to y, and from y to z, in the list of numbers: 1 in a table of poses, 4 in a table of 3 x 4
matrices."""
SAME_M = 0.001  #: Coordinates are rounded to 1 mm, the coarsest resolution of common files.
MOST_POSITIONS = 10  #: Allowed number of true positions: a start, a goal and waypoints are legitimate settings.
FAR_M = 1e9  #: Larger numbers are not coordinates but, for example, stamps. Stamps in ns would overflow 64 bits in mm.


def units_of(positions: FloatArray) -> set[tuple[int, ...]]:
    """Return the set of positions `(N, 3)` as integer multiples of `SAME_M`."""
    return {tuple(row) for row in np.rint(positions / SAME_M).astype(np.int64).tolist()}


def check_configuration(text: str, truth: Trajectory | None) -> None:
    """Raise ConfigError if the text of a configuration contains more than `MOST_POSITIONS` true positions.

    A modified copy, for example scaled or compressed, is not detected.
    """
    if truth is None or not text:
        return
    numbers = np.array([float(word) for word in NUMBER.findall(text)], np.float64)
    numbers = np.where(np.abs(numbers) < FAR_M, numbers, np.nan)
    true = units_of(truth.positions)
    named = true | units_of(truth.positions @ OPTICAL_IN_BODY)  # KITTI files use the axes of a camera
    found = set[tuple[int, ...]]()
    for stride in STRIDES:
        count = len(numbers) - 2 * stride
        rows = np.column_stack([numbers[place * stride : place * stride + max(count, 0)] for place in range(3)])
        found |= named & units_of(rows[np.isfinite(rows).all(axis=1)])
    if len(found) > MOST_POSITIONS:
        raise ConfigError(
            f"the configuration of the method contains {len(found)} of {len(true)} positions of the ground truth: a "
            "method under test must not know them; give a configuration without them"
        )
