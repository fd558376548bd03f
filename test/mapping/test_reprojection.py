"""Points against the pinhole equations, their sigma against Monte Carlo."""

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.reprojection import cloud_from_disparity

RIG = StereoRig(32, 24, 40.0, 44.0, 14.5, 12.25, 0.25)
POSE = Transform(matrix_from_rotvec([0.4, -1.1, 0.7]), np.array([3.0, -1.0, 2.0]))
RNG = np.random.default_rng(0)
DISPARITY = RNG.uniform(1.0, 8.0, (RIG.height, RIG.width)).astype(np.float32)
DISPARITY[RNG.uniform(size=DISPARITY.shape) < 0.3] = np.nan
DISPARITY[5] = np.nan
SIGMA = RNG.uniform(0.01, 0.1, DISPARITY.shape).astype(np.float32)
LEFT = RNG.integers(0, 256, DISPARITY.shape, dtype=np.uint8)


def project(local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return u, v and disparity of points of the left optical frame."""
    x, y, z = local.T
    u_right = RIG.fx * (x - RIG.baseline_m) / z + RIG.cx
    u = RIG.fx * x / z + RIG.cx
    return u, RIG.fy * y / z + RIG.cy, u - u_right


def test_points_project_to_their_pixel_and_disparity() -> None:
    cloud = cloud_from_disparity(DISPARITY, SIGMA, LEFT, RIG, POSE, 2)
    u, v, disparity = project(POSE.inverse().apply(cloud.xyz))
    np.testing.assert_allclose(u, cloud.u, atol=1e-4)
    np.testing.assert_allclose(v, cloud.v, atol=1e-4)
    np.testing.assert_allclose(disparity, DISPARITY[cloud.v, cloud.u], rtol=1e-5)


def test_every_pixel_with_a_disparity_gives_a_point_in_order() -> None:
    cloud = cloud_from_disparity(DISPARITY, SIGMA, LEFT, RIG, POSE, 2)
    v, u = np.nonzero(np.isfinite(DISPARITY))
    np.testing.assert_array_equal(cloud.u, u)
    np.testing.assert_array_equal(cloud.v, v)
    np.testing.assert_array_equal(cloud.intensity, LEFT[v, u])
    assert (cloud.pair == 2).all()
    assert len(cloud_from_disparity(np.full_like(DISPARITY, np.nan), SIGMA, LEFT, RIG, POSE, 0)) == 0


@pytest.mark.parametrize("sigma_px", [0.02, 0.1])
def test_sigma_is_the_scatter_along_the_ray(sigma_px: float) -> None:
    """Disparities drawn from a normal distribution; the ranges scatter by what is stated."""
    truth = np.full((RIG.height, RIG.width), 5.0)
    ranges = []
    for _ in range(600):
        drawn = RNG.normal(truth, sigma_px).astype(np.float32)
        cloud = cloud_from_disparity(drawn, np.full_like(drawn, sigma_px), LEFT, RIG, POSE, 0)
        ranges.append(np.linalg.norm(cloud.xyz - POSE.translation, axis=1))
    stated = cloud_from_disparity(truth.astype(np.float32), np.full_like(SIGMA, sigma_px), LEFT, RIG, POSE, 0).sigma
    ratio = np.std(ranges, axis=0) / stated
    assert ratio.mean() == pytest.approx(1.0, abs=0.01)
    assert ratio.std() < 0.04
