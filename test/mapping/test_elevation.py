"""Elevation models and covariances against what was put in."""

import numpy as np
import pytest

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.elevation import SLOPE, elevation_from_cloud, point_covariances

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
