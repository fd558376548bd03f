"""Checks of a cloud, which may come from a file or from another method, before grids or covariances are computed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.geometry.transform import Transform

SIGMA_ROUNDING = 1e-6  #: Relative excess of a random sigma over the total sigma that is due to rounding to float32.


def check_points(xyz: FloatArray32) -> None:
    """Raise MappingError if a coordinate of points `(N, 3)` is not finite."""
    if not np.isfinite(xyz).all():
        raise MappingError("the cloud has points that are not finite: remove them")


def check_poses(poses_lm_left: Sequence[Transform]) -> None:
    """Raise MappingError if a pose has a wrong type."""
    for pose in poses_lm_left:
        if not isinstance(pose, Transform):
            raise MappingError(f"a pose of a left camera has the type {type(pose).__name__}: a Transform is required")


def check_sigma(sigma: FloatArray32, name: str) -> None:
    """Raise MappingError if a standard deviation `(N,)`, named for the message, is negative or not finite."""
    if not ((sigma >= 0.0) & (sigma < np.inf)).all():
        raise MappingError(
            f"{name} has values that are negative or not finite: at least 0 m is required; remove these points, or "
            "give their standard deviations"
        )


def check_random_sigma(random: FloatArray32, total: FloatArray32) -> None:
    """Raise MappingError unless each point has a random sigma `(N,)` that does not exceed its total sigma `(N,)`."""
    if np.shape(random) != total.shape:
        raise MappingError(
            f"random_sigma has the shape {np.shape(random)}: {total.shape}, a value for each point of the cloud, is "
            "required"
        )
    check_sigma(random, "random_sigma")
    if (random > total * (1.0 + SIGMA_ROUNDING)).any():
        raise MappingError(
            "random_sigma exceeds the sigma of the cloud, which contains it: at most the sigma of each point is "
            "required; correct random_sigma, or omit it"
        )
