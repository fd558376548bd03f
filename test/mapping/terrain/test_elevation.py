"""Elevation models and covariances against what was put in."""

import numpy as np
import pytest

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.reprojection import cloud_from_disparity
from sfr_loc_map.mapping.terrain.elevation import SLOPE, elevation_from_cloud, point_covariances, rays

CENTRES = [np.array([0.0, 0.0, 2.0]), np.array([1.0, 0.0, 2.0])]
POSES = [Transform(matrix_from_rotvec([-1.9, 0.3, 0.2]), centre) for centre in CENTRES]


def cloud_of(xyz: list[list[float]], sigma: list[float], pair: list[int]) -> PointCloud:
    zeros = np.zeros(len(xyz))
    return PointCloud(
        np.array(xyz, np.float32).reshape(-1, 3),
        np.array(sigma, np.float32),
        zeros.astype(np.float32),
        zeros.astype(np.uint16),
        zeros.astype(np.uint16),
        np.array(pair, np.uint8),
    )


def test_cells_lie_where_their_points_do() -> None:
    xyz = [[-0.05, 0.25, 1.0], [0.35, -0.15, 2.0], [0.36, -0.19, 4.0]]
    model = elevation_from_cloud(cloud_of(xyz, [0.01] * 3, [0] * 3), POSES, 0.1)
    assert model.origin_m == pytest.approx((-0.1, -0.2))
    assert model.height_m.shape == model.count.shape == model.sigma_m.shape == (5, 5)
    assert model.height_m[4, 0] == pytest.approx(1.0)
    assert model.count[4, 0] == 1
    assert model.count[0, 4] == 2
    assert 2.0 < model.height_m[0, 4] < 4.0
    assert np.isfinite(model.height_m).sum() == 2


def test_heights_are_weighed_by_the_variance_of_height_not_of_range() -> None:
    """One point straight below its camera, one seen at a slant of 0.6: at equal sigma it is more accurate."""
    xyz = [[1.55, 0.0, 0.0], [1.45, 0.0, 0.01]]
    poses = [
        Transform(np.eye(3), np.array([1.55, 0.0, 2.0])),
        Transform(np.eye(3), np.array([1.45 - 2.6533, 0.0, 2.0])),
    ]
    model = elevation_from_cloud(cloud_of(xyz, [0.02, 0.02], [0, 1]), poses, 1.0)
    below, slant = (0.02**2 * (z * z + SLOPE**2) for z in (1.0, 0.6))
    weights = np.array([1.0 / below, 1.0 / slant])
    assert model.height_m[0, 0] == pytest.approx(0.01 * weights[1] / weights.sum(), rel=0.01)
    spread = weights[0] * weights[1] / weights.sum() ** 2 * 0.01**2
    assert model.sigma_m[0, 0] == pytest.approx(np.sqrt(2.0 / weights.sum() + spread / 2.0), rel=0.01)


def test_an_error_that_points_share_has_no_say_in_weights_and_no_mean_removes_it() -> None:
    xyz = [[0.05, 0.05, 0.0], [0.06, 0.05, 0.01], [0.07, 0.05, 0.02]]
    random = np.array([0.01, 0.02, 0.01], np.float32)
    plain = elevation_from_cloud(cloud_of(xyz, random.tolist(), [0] * 3), POSES, 1.0)
    common = elevation_from_cloud(cloud_of(xyz, np.hypot(random, 0.3).tolist(), [0] * 3), POSES, 1.0, random)
    assert common.height_m[0, 0] == plain.height_m[0, 0]
    slant = rays(cloud_of(xyz[:1], [0.01], [0]), POSES)[0, 2]
    expected = np.sqrt(plain.sigma_m[0, 0] ** 2 + 0.3**2 * (slant**2 + SLOPE**2))
    assert common.sigma_m[0, 0] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("cell", "message"), [(0.0, "more than 0"), (-1.0, "more than 0"), (1e-4, "million")])
def test_cells_that_cannot_be_are_refused(cell: float, message: str) -> None:
    cloud = cloud_of([[0.0, 0.0, 0.0], [9.0, 9.0, 0.0]], [0.01] * 2, [0] * 2)
    with pytest.raises(MappingError, match=message):
        elevation_from_cloud(cloud, POSES, cell)
    with pytest.raises(MappingError, match="no points"):
        elevation_from_cloud(cloud.select(np.zeros(2, bool)), POSES, 0.1)


def test_covariance_is_that_of_the_ray_and_of_the_pixel() -> None:
    local = np.array([[0.3, -0.2, 4.0], [0.0, 0.0, 7.0]])
    xyz = [POSES[pair].apply(point).tolist() for pair, point in enumerate(local)]
    matrices = point_covariances(cloud_of(xyz, [0.05, 0.02], [0, 1]), POSES, 800.0)
    for pair, sigma in enumerate((0.05, 0.02)):
        values, vectors = np.linalg.eigh(matrices[pair].astype(np.float64))
        np.testing.assert_allclose(values[:2], (local[pair, 2] / 800.0) ** 2 / 12.0, rtol=1e-2)
        assert values[2] == pytest.approx(sigma**2, rel=1e-4)
        ray = POSES[pair].rotation @ local[pair] / np.linalg.norm(local[pair])
        assert abs(vectors[:, 2] @ ray) == pytest.approx(1.0, abs=1e-6)


def test_covariance_is_the_scatter_of_points_of_a_pixel() -> None:
    """Points drawn over the area of a pixel and over the error of its disparity, against the stated covariance."""
    rig = StereoRig(640, 480, 300.0, 300.0, 319.5, 239.5, 0.2)
    rng = np.random.default_rng(0)
    u, v, disparity, sigma_px = 400.0, 150.0, 12.0, 0.05
    drawn = 200_000
    depth = rig.fx * rig.baseline_m / rng.normal(disparity, sigma_px, drawn)
    ray_x = (rng.uniform(u - 0.5, u + 0.5, drawn) - rig.cx) / rig.fx
    ray_y = (rng.uniform(v - 0.5, v + 0.5, drawn) - rig.cy) / rig.fy
    points = POSES[1].apply(np.column_stack((ray_x, ray_y, np.ones(drawn))) * depth[:, None])
    image = np.full((rig.height, rig.width), np.nan, np.float32)
    image[int(v), int(u)] = disparity
    deviation, grey = np.full_like(image, sigma_px), np.zeros(image.shape, np.uint8)
    cloud = cloud_from_disparity(image, deviation, grey, rig, POSES[1], 1)
    stated = point_covariances(cloud, POSES, rig.fx)[0]
    found = np.cov(points.T)
    np.testing.assert_allclose(stated, found, atol=0.05 * np.trace(found))
    np.testing.assert_allclose(np.linalg.eigvalsh(stated)[:2], np.linalg.eigvalsh(found)[:2], rtol=0.2)


def test_rays_are_unit_vectors_from_the_camera_to_the_point() -> None:
    xyz = [[1.0, 2.0, 0.0], [3.0, 0.0, 2.0]]
    found = rays(cloud_of(xyz, [0.1, 0.1], [0, 1]), POSES)
    np.testing.assert_allclose(found[0], np.array([1.0, 2.0, -2.0]) / 3.0, atol=1e-6)
    np.testing.assert_allclose(found[1], [1.0, 0.0, 0.0], atol=1e-6)


def test_a_plane_gives_a_plane() -> None:
    """Many points of sloping ground: each cell has the height of its points, and a sigma that covers its slope."""
    rng = np.random.default_rng(1)
    xy = rng.uniform(0.0, 2.0, (40_000, 2))
    xyz = np.column_stack((xy, 0.3 * xy[:, 0] - 0.2 * xy[:, 1]))
    model = elevation_from_cloud(cloud_of(xyz.tolist(), [0.01] * len(xyz), [0] * len(xyz)), POSES, 0.1)
    rows, cols = model.height_m.shape
    y, x = np.mgrid[:rows, :cols] * 0.1 + 0.05
    np.testing.assert_allclose(model.height_m, 0.3 * x - 0.2 * y, atol=0.01)
    assert model.count.sum() == len(xyz)
    assert (model.sigma_m < 0.02).all()
