"""Elevation models and covariances against what was put in."""

import numpy as np
import pytest

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.point_covariance import point_covariances
from sfr_loc_map.mapping.terrain.cells import MAX_CELLS, CellGrid, Square
from sfr_loc_map.mapping.terrain.elevation import TYPICAL_SLOPE, ElevationModel, elevation_model

CENTRES = [np.array([0.0, 0.0, 2.0]), np.array([1.0, 0.0, 2.0])]
POSES = [Transform(matrix_from_rotvec([-1.9, 0.3, 0.2]), centre) for centre in CENTRES]


def cloud_of(xyz: list[list[float]], sigma: list[float], pair: list[int]) -> PointCloud:
    grey, pixel = np.zeros(len(xyz), np.float32), np.zeros(len(xyz), np.uint16)
    points = np.array(xyz, np.float32)
    return PointCloud(points, np.array(sigma, np.float32), grey, pixel, pixel, np.array(pair, np.uint8))


def elevation_from_cloud(
    cloud: PointCloud, poses: list[Transform], cell_m: float, random: np.ndarray | None = None
) -> ElevationModel:
    cells = CellGrid.over(cloud.xyz, cell_m)
    return elevation_model(cloud, cells, cells.cell_of(cloud.xyz), poses, random)


def points(*xy: tuple[float, float]) -> np.ndarray:
    return np.array([(x, y, 0.0) for x, y in xy], np.float32)


def test_grids_of_one_cell_size_share_their_cells_within_reach() -> None:
    one = CellGrid.over(points((0.05, 0.05), (0.95, 0.45)), 0.1)
    other = CellGrid.over(points((-0.35, 0.25), (0.55, 0.26)), 0.1)
    assert (one.first_column, one.first_row, one.rows, one.columns) == (0, 0, 5, 10)
    assert (other.first_column, other.first_row, other.rows, other.columns) == (-4, 2, 1, 10)
    assert other.origin_m == pytest.approx((-0.4, 0.2))
    assert one.cell_of(points((0.55, 0.25), (-0.01, 0.0), (1.01, 0.0), (0.0, 0.51))).tolist() == [25, -1, -1, -1]
    near = CellGrid.over(points((0.05, 0.05), (90.0, 0.0), (1.02, -1.02)), 0.1, Square(0.0, 0.0, 2.0))
    assert (near.first_column, near.first_row, near.rows, near.columns) == (0, -11, 12, 21)


@pytest.mark.parametrize(
    ("xy", "cell", "within", "message"),
    [
        ([(0.0, 0.0), (9.0, 9.0)], 0.0, None, "a positive number is required"),
        ([], 0.1, None, "no points"),
        ([(0.0, 0.0), (np.inf, 0.0)], 0.1, Square(0.0, 0.0, 2.0), "not finite"),
        ([(90.0, 0.0)], 0.1, Square(0.0, 0.0, 2.0), r"no points within 2\.0 m of \(0, 0\) .* \(terrain\.range_m\)"),
    ],
)
def test_cells_that_cannot_be_are_refused(
    xy: list[tuple[float, float]], cell: float, within: Square | None, message: str
) -> None:
    with pytest.raises(MappingError, match=message):
        CellGrid.over(points(*xy).reshape(-1, 3), cell, within)


@pytest.mark.parametrize(("x", "y"), [(537.0, 270.0), (9.0, 1e9), (1e7, 0.0), (4e5, 3e37)])
def test_a_grid_of_too_many_cells_is_refused(x: float, y: float) -> None:
    """Of 537 x 270 m, as by a flipped bit, a grid of 0.1 m would take 1.5 GB."""
    with pytest.raises(MappingError, match=r"at most \S+ million are allowed; use larger cells .* \(terrain\.cell_m"):
        CellGrid.over(points((0.05, 0.0), (x, y)), 0.1)


def test_a_grid_may_have_the_maximum_number_of_cells() -> None:
    columns = MAX_CELLS // 1000
    grid = CellGrid.over(points((0.5, 0.5), (columns - 0.5, 999.5)), 1.0)
    assert grid.rows * grid.columns == MAX_CELLS


def test_heights_are_weighed_by_the_variance_of_height_not_of_range() -> None:
    """Two points straight below their camera, two seen at a slant of 0.6: at equal sigma these are more accurate."""
    xyz = [[1.55, 0.0, 0.0], [1.45, 0.0, 0.01]]
    poses = [
        Transform(np.eye(3), np.array([1.55, 0.0, 2.0])),
        Transform(np.eye(3), np.array([1.45 - 2.6533, 0.0, 2.0])),
    ]
    model = elevation_from_cloud(cloud_of(2 * xyz, 4 * [0.02], 2 * [0, 1]), poses, 1.0)
    below, slant = (0.02**2 * (z * z + TYPICAL_SLOPE**2) for z in (1.0, 0.6))
    weights = np.array([1.0 / below, 1.0 / slant])
    assert model.height_m[0, 0] == pytest.approx(0.01 * weights[1] / weights.sum(), rel=0.01)
    spread = weights[0] * weights[1] / weights.sum() ** 2 * 0.01**2
    assert model.sigma_m[0, 0] == pytest.approx(np.sqrt(2.0 / weights.sum() + spread / 4.0), rel=0.01)


def test_an_error_that_points_share_has_no_say_in_weights_and_no_mean_removes_it() -> None:
    xyz = [[0.05, 0.05, 0.0], [0.06, 0.05, 0.01], [0.07, 0.05, 0.02]]
    random = np.array([0.01, 0.02, 0.01], np.float32)
    plain = elevation_from_cloud(cloud_of(xyz, random.tolist(), [0] * 3), POSES, 1.0)
    common = elevation_from_cloud(cloud_of(xyz, np.hypot(random, 0.3).tolist(), [0] * 3), POSES, 1.0, random)
    assert common.height_m[0, 0] == plain.height_m[0, 0]
    expected = np.sqrt(plain.sigma_m[0, 0] ** 2 + 0.3**2 * (1.0 + TYPICAL_SLOPE**2))  # seen from above
    assert common.sigma_m[0, 0] == pytest.approx(expected, rel=0.01)


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


def test_points_with_a_sigma_of_zero_have_equal_weights() -> None:
    cloud = cloud_of([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2], [0.0, 0.0, 0.6]], [0.0] * 3, [0] * 3)
    model = elevation_from_cloud(cloud, POSES, 1.0)
    np.testing.assert_allclose(model.height_m, 0.3)
    assert (model.sigma_m > 0.0).all()
