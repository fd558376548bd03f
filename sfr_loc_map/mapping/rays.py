"""Rays from the left cameras to the points of a cloud."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray, FloatArray32
from sfr_loc_map.geometry.transform import Transform


def rays_from_cameras(
    xyz: FloatArray32, pair_index: NDArray[np.uint8], poses_lm_left: Sequence[Transform]
) -> FloatArray:
    """Return the vector `(N, 3)` from the left camera of each point's pair to the point, metres, LM.

    `pair_index` `(N,)` is the index of each point's pair in `poses_lm_left`. Raises MappingError if a pose is missing.
    """
    largest = int(pair_index.max(initial=0))
    if largest >= len(poses_lm_left):
        raise MappingError(
            f"the cloud has points of pair index {largest}, and {len(poses_lm_left)} poses are given: a pose for each "
            "pair index is required"
        )
    centres = np.stack([pose.translation for pose in poses_lm_left])
    return np.asarray(xyz - centres.take(pair_index, axis=0))
