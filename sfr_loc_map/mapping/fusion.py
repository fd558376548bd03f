"""One cloud from up to three pairs."""

from __future__ import annotations

from collections.abc import Sequence

from sfr_loc_map.geometry.cloud import PointCloud


def merged(clouds: Sequence[PointCloud]) -> PointCloud:
    """Return the points of all pairs."""
    return PointCloud.concatenate(clouds)
