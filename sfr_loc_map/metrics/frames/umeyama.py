"""The least-squares alignment of points with their targets (Umeyama 1991)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray

RANK_TOLERANCE = 1e-12
"""Smallest ratio of the second to the first singular value that determines a rotation. Singular values are products of
extents, so a path whose width is below a millionth of its length is straight; such a width is only rounding."""


class Similarity(NamedTuple):
    """The transform `p -> scale R p + t`."""

    scale: float
    rotation: FloatArray
    translation: FloatArray


def umeyama(points: FloatArray, targets: FloatArray, *, with_scale: bool) -> Similarity:
    """Return the least-squares similarity from points `(N, 3)` to their targets (equations of Umeyama 1991).

    MetricsError if the points are collinear or coincide, so the rotation is undetermined.
    """
    mean_p, mean_t = points.mean(axis=0), targets.mean(axis=0)
    p, t = points - mean_p, targets - mean_t
    covariance = t.T @ p / len(points)  # equation 38
    u, singular, vt = np.linalg.svd(covariance)
    smallest = max(float(np.finfo(np.float64).eps), RANK_TOLERANCE * float(singular[0]))
    if np.count_nonzero(singular > smallest) < 2:
        raise MetricsError(
            f"{len(points)} positions on a line or at one point have no least-squares alignment: use align=origin"
        )
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt)) or 1.0])  # equation 43
    rotation = (u * signs) @ vt  # equation 40
    scale = float((singular * signs).sum() / np.square(p).sum(axis=1).mean()) if with_scale else 1.0  # equation 42
    return Similarity(scale, rotation, mean_t - scale * (rotation @ mean_p))  # equation 41
