"""Checks of a cloud, which may come from a file or from another method, before grids or covariances are computed."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray32


def check_points(xyz: FloatArray32) -> None:
    """Raise MappingError if a coordinate of points `(N, 3)` is not finite."""
    if not np.isfinite(xyz).all():
        raise MappingError("the cloud has points that are not finite: remove them")


def check_sigma(sigma: FloatArray32, name: str) -> None:
    """Raise MappingError if a standard deviation `(N,)`, named for the message, is negative or not finite."""
    if not ((sigma >= 0.0) & (sigma < np.inf)).all():
        raise MappingError(
            f"{name} has values that are negative or not finite: at least 0 m is required; remove these points, or "
            "give their standard deviations"
        )
