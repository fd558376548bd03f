"""The similarity that takes points to others by least squares (Umeyama 1991, IEEE PAMI 13(4), 376-380)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray


class Similarity(NamedTuple):
    """`p -> scale R p + t`."""

    scale: float
    rotation: FloatArray
    translation: FloatArray

    def apply(self, points: FloatArray) -> FloatArray:
        """Take points `(N, 3)` along."""
        return np.asarray((self.scale * points) @ self.rotation.T + self.translation)


def umeyama(points: FloatArray, targets: FloatArray, *, with_scale: bool) -> Similarity:
    """Return the similarity that takes points nearest to their targets: `min sum |target - (s R p + t)|^2`.

    Args:
        points: `(N, 3)`, metres.
        targets: `(N, 3)`, metres.
        with_scale: Whether the scale is estimated; otherwise it is 1.

    Raises:
        MetricsError: If the points lie on a line or in one place, so that no rotation follows from them.
    """
    mean_p, mean_t = points.mean(axis=0), targets.mean(axis=0)
    p, t = points - mean_p, targets - mean_t
    covariance = t.T @ p / len(points)  # equation 38
    u, singular, vt = np.linalg.svd(covariance)
    if np.count_nonzero(singular > np.finfo(np.float64).eps) < 2:
        raise MetricsError(
            f"{len(points)} positions on a line or in one place have no alignment by least squares: use --align origin"
        )
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt)) or 1.0])  # equation 43
    rotation = (u * signs) @ vt  # equation 40
    scale = float((singular * signs).sum() / np.square(p).sum(axis=1).mean()) if with_scale else 1.0  # equation 42
    return Similarity(scale, rotation, mean_t - scale * (rotation @ mean_p))  # equation 41
