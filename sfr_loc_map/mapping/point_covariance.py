"""The covariance of points: sigma along the ray, and the footprint of a pixel across the ray."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import F, FloatArray, FloatArray32
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.cloud_checks import check_points, check_poses, check_sigma


def point_covariances(cloud: PointCloud, poses_lm_left: Sequence[Transform], focal_px: float) -> FloatArray32:
    """Return the covariance of each point in LM `(N, 3, 3)`, square metres.

    The variance along the ray is the point's `sigma^2`. Across the ray a point represents its pixel: a uniform
    distribution over a square of side `Z / f`, whose variance is `(Z / f)^2 / 12`. The pair index of a point is the
    index of its pose.

    Raises MappingError if a pose is missing or has a wrong type, if a point is at its camera, if a coordinate is not
    finite, if a sigma is negative or not finite, or if the focal length f, `focal_px`, is not positive and finite.
    """
    if not 0.0 < focal_px < np.inf:
        raise MappingError(f"focal_px is {focal_px}: a positive, finite number is required")
    if not len(cloud):
        return np.zeros((0, 3, 3), F)
    check_points(cloud.xyz)
    check_sigma(cloud.sigma, "the sigma of the cloud")
    check_poses(poses_lm_left)
    ray = rays_from_cameras(cloud.xyz, cloud.pair, poses_lm_left)
    if not ray.any(axis=1).all():
        raise MappingError("the cloud has a point at the position of its camera, which has no ray: remove this point")
    axes = np.stack([pose.rotation[:, 2] for pose in poses_lm_left])[cloud.pair]
    depth = np.einsum("ij,ij->i", ray, axes)
    ray /= np.sqrt(np.einsum("ij,ij->i", ray, ray))[:, None]
    across = np.square(depth / focal_px) / 12.0
    along = np.square(cloud.sigma.astype(np.float64))
    covariance = np.einsum("n,ni,nj->nij", along - across, ray, ray)
    covariance[:, [0, 1, 2], [0, 1, 2]] += across[:, None]
    return np.asarray(covariance, F)


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
    rays = centres.take(pair_index, axis=0)
    return np.subtract(xyz, rays, out=rays)  # in place, because a cloud may have millions of points
