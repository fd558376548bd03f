"""Slope, roughness, step and hazard of ground that is known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sfr_loc_map.errors import ConfigError, MappingError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.point_covariance import point_covariances
from sfr_loc_map.mapping.terrain.terrain_grid import STEP_RADIUS_M, TerrainGrid, terrain_grid

CONFIG = TerrainConfig()
CAMERA = [Transform(np.eye(3), np.array([0.0, 0.0, 2.0]))]
SPACING = 0.02
"""Of the points; 25 in a cell."""


def ground(height, keep=lambda x, y: np.ones(x.shape, bool)) -> PointCloud:  # noqa: ANN001
    side = np.arange(-2.0, 2.0, SPACING) + SPACING / 2
    x, y = (axis[keep(*np.meshgrid(side, side))] for axis in np.meshgrid(side, side))
    xyz = np.column_stack((x, y, height(x, y))).astype(np.float32)
    zeros, sigma = np.zeros(len(xyz), np.uint16), np.full(len(xyz), 0.005, np.float32)
    return PointCloud(xyz, sigma, sigma, zeros, zeros, zeros.astype(np.uint8))


def at(grid: TerrainGrid, layer: np.ndarray, x: float, y: float) -> float:
    x0, y0 = grid.elevation.origin_m
    return float(layer[int((y - y0) / CONFIG.cell_m), int((x - x0) / CONFIG.cell_m)])


@pytest.mark.parametrize(("rise_x", "rise_y"), [(0.0, 0.0), (0.3, 0.0), (-0.1, 0.25)])
def test_a_plane_has_its_slope_and_neither_roughness_nor_step(rise_x: float, rise_y: float) -> None:
    grid = terrain_grid(ground(lambda x, y: rise_x * x + rise_y * y), CONFIG, CAMERA)
    rise = np.hypot(rise_x, rise_y)
    inside = np.isfinite(grid.slope_rad)
    assert inside[2:-2, 2:-2].all()  # at the corners less than half of the footprint is known
    np.testing.assert_allclose(grid.slope_rad[inside], np.arctan(rise), atol=5e-4)
    assert grid.roughness_m[inside].max() < 1e-4
    assert grid.step_m[inside].max() < rise * CONFIG.cell_m + 1e-4  # beside cells without a plane, which may rise
    assert grid.step_m[5:-5, 5:-5].max() < 1e-3
    share = np.degrees(np.arctan(rise)) / CONFIG.max_slope_deg
    assert np.abs(grid.hazard[inside] - 100.0 * share).max() <= 1.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_rock_or_a_hole_is_a_hazard_as_far_as_the_footprint_reaches(sign: float) -> None:
    def rock(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return sign * 0.25 * ((np.abs(x - 0.05) < 0.15) & (np.abs(y - 0.05) < 0.15))

    grid = terrain_grid(ground(rock), CONFIG, CAMERA)
    assert at(grid, grid.step_m, 0.05, 0.05) == pytest.approx(0.25, abs=0.02)
    rows, columns = (np.nonzero(grid.hazard == 100) + np.array([[0.5], [0.5]])) * 0.1
    distance = np.hypot(grid.elevation.origin_m[0] + columns - 0.05, grid.elevation.origin_m[1] + rows - 0.05)
    assert distance.max() < 0.15 * np.sqrt(2) + STEP_RADIUS_M + CONFIG.footprint_radius_m + 0.1
    reach = 0.15 + CONFIG.footprint_radius_m
    for x, y in ((reach, 0.05), (0.05, -reach + 0.1), (0.4, 0.4)):
        assert at(grid, grid.hazard, x, y) == 100
    assert at(grid, grid.hazard, 1.55, 1.55) == 0
    low = terrain_grid(ground(lambda x, y: 0.5 * rock(x, y)), CONFIG, CAMERA)
    assert 50 <= low.hazard.max() < 100


@pytest.mark.parametrize("radius_cells", [3, 5, 6, 7])
def test_cells_on_the_circle_of_the_footprint_are_inside(radius_cells: int) -> None:
    """0.3 / 0.1, 0.6 / 0.1 and 0.7 / 0.1 are rounded to less than 3, 6 and 7."""

    def rock(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 0.25 * ((np.abs(x - 0.05) < 0.05) & (np.abs(y - 0.05) < 0.05))

    config = replace(CONFIG, footprint_radius_m=float(f"0.{radius_cells}"))
    grid = terrain_grid(ground(rock), config, CAMERA)
    row = int((0.05 - grid.elevation.origin_m[1]) / config.cell_m)
    steps = np.flatnonzero(grid.step_m[row] >= config.max_step_m)
    hazards = np.flatnonzero(grid.hazard[row] == 100)
    assert len(steps)
    assert hazards.tolist() == list(range(steps[0] - radius_cells, steps[-1] + radius_cells + 1))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("points", [3, 4])
def test_one_outlier_of_a_cell_of_few_points_is_no_step(points: int, sign: float) -> None:
    side = np.arange(-2.0, 2.0, 0.05) + 0.025  # two rows and two columns of points in each cell
    x, y = (axis.ravel() for axis in np.meshgrid(side, side))
    fourth = (np.rint((x - 0.025) / 0.05) % 2 == 1) & (np.rint((y - 0.025) / 0.05) % 2 == 1)
    kept = ~fourth if points == 3 else np.ones(len(x), bool)
    outlier = np.hypot(x - 0.025, y - 0.025) < 0.01
    xyz = np.column_stack((x, y, sign * 0.4 * outlier)).astype(np.float32)[kept]
    zeros, sigma = np.zeros(len(xyz), np.uint16), np.full(len(xyz), 0.005, np.float32)
    cloud = PointCloud(xyz, sigma, sigma, zeros, zeros, zeros.astype(np.uint8))
    assert np.count_nonzero(cloud.xyz[:, 2]) == 1
    grid = terrain_grid(cloud, CONFIG, CAMERA)
    assert at(grid, grid.elevation.count, 0.05, 0.05) == points
    assert np.nanmax(grid.step_m) < 0.05
    assert grid.hazard.max() < 100


def test_rough_ground_is_rough() -> None:
    def waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 0.065 * np.sqrt(2.0) * np.sin(2.0 * np.pi * x / 0.8)

    grid = terrain_grid(ground(waves), replace(CONFIG, max_step_m=1.0), CAMERA)
    middle = np.s_[10:30, 10:30]
    assert np.median(grid.roughness_m[middle]) == pytest.approx(0.06, abs=0.01)
    assert (grid.hazard[middle] == 100).mean() > 0.5


def test_what_was_not_seen_is_not_known_unless_a_step_is_near() -> None:
    hidden = lambda x, y: ~((x > 0.5) & (np.abs(y) < 1.0))  # noqa: E731
    flat = terrain_grid(ground(lambda x, y: 0.0 * x, keep=hidden), CONFIG, CAMERA)
    assert [at(flat, layer, 1.45, 0.05) for layer in (flat.hazard, flat.elevation.count)] == [-1, 0]
    assert np.isnan([at(flat, layer, 1.45, 0.05) for layer in (flat.slope_rad, flat.elevation.height_m)]).all()
    rock = lambda x, y: 0.3 * ((x > 0.3) & (np.abs(y) < 0.2))  # noqa: E731
    shadow = terrain_grid(ground(rock, keep=hidden), CONFIG, CAMERA)
    assert at(shadow, shadow.hazard, 0.65, 0.05) == 100
    assert at(shadow, shadow.hazard, 1.45, 0.05) == -1


@pytest.mark.parametrize(("height_m", "is_hazard"), [(1.0, True), (0.3, True), (0.1, False), (-1.0, True)])
@pytest.mark.parametrize("gap_m", [0.0, 0.2, 0.6, 1.2])
def test_a_rock_or_a_hole_beyond_a_gap_is_a_hazard(height_m: float, gap_m: float, *, is_hazard: bool) -> None:
    """The side of a rock of 0.3 x 0.3 m is observed, at all heights in each of its cells."""
    flat = ground(lambda x, y: 0.0 * x, keep=lambda x, y: x < 0.0)
    rng = np.random.default_rng(0)
    rock = np.column_stack(
        (rng.uniform(gap_m, gap_m + 0.3, 300), rng.uniform(0.0, 0.3, 300), rng.uniform(0.0, 1.0, 300) * height_m)
    )
    xyz = np.concatenate((flat.xyz, rock.astype(np.float32)))
    zeros, sigma = np.zeros(len(xyz), np.uint16), np.full(len(xyz), 0.005, np.float32)
    grid = terrain_grid(PointCloud(xyz, sigma, sigma, zeros, zeros, zeros.astype(np.uint8)), CONFIG, CAMERA)
    steps = [at(grid, grid.step_m, gap_m + x, 0.15) for x in (0.05, 0.15, 0.25)]
    assert np.isfinite(steps).all()
    hazards = [at(grid, grid.hazard, gap_m + x, 0.15) for x in (0.05, 0.15, 0.25)]
    assert (hazards == [100.0] * 3) == is_hazard
    unknown = np.isnan(grid.slope_rad) & (grid.hazard < 100)
    assert (grid.hazard[unknown] == -1).all()


def beyond_a_gap(gap_m: float, height: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> PointCloud:
    """Return ground at x < 0, and a patch of 0.3 x 0.3 m beyond a gap, both at a height that depends on x and y."""
    return ground(height, keep=lambda x, y: (x < 0.0) | ((np.abs(x - gap_m - 0.15) < 0.15) & (np.abs(y - 0.15) < 0.15)))


@pytest.mark.parametrize(
    ("gap_m", "height_m", "is_hazard"),
    [
        (0.0, 0.3, True),
        (0.1, 0.3, True),
        (0.2, 0.5, True),
        (0.2, -0.5, True),  # the bottom of a hole
        (0.4, 0.5, True),
        (0.4, -1.0, True),
        (0.2, 0.1, False),
        (0.4, 0.15, False),
        (0.6, 1.0, False),  # beyond the footprint: unknown
    ],
)
def test_the_flat_top_of_an_obstacle_beyond_a_gap_is_a_hazard(
    gap_m: float, height_m: float, *, is_hazard: bool
) -> None:
    """Within the footprint of 0.5 m, the difference exceeds the limit of a step and what a slope of 20 deg explains."""
    cloud = beyond_a_gap(gap_m, lambda x, y: height_m * (x > 0.0))
    grid = terrain_grid(cloud, CONFIG, CAMERA)
    hazard = at(grid, grid.hazard, gap_m + 0.05, 0.15)
    assert (hazard == 100.0) == is_hazard
    step = at(grid, grid.step_m, gap_m + 0.05, 0.15)
    if np.isnan(at(grid, grid.slope_rad, gap_m + 0.05, 0.15)) and gap_m < 0.5:
        rise = np.tan(np.radians(CONFIG.max_slope_deg)) * (gap_m + CONFIG.cell_m)
        assert step == pytest.approx(max(abs(height_m) - rise, 0.0), abs=1e-3)


@pytest.mark.parametrize("slope_deg", [-18.0, 18.0])
@pytest.mark.parametrize("gap_m", [0.1, 0.2, 0.4])
def test_a_passable_slope_beyond_a_gap_is_no_hazard(gap_m: float, slope_deg: float) -> None:
    rise = np.tan(np.radians(slope_deg))
    grid = terrain_grid(beyond_a_gap(gap_m, lambda x, y: rise * x), CONFIG, CAMERA)
    assert grid.hazard.max() < 100


def test_a_passable_slope_of_large_cells_is_no_step() -> None:
    rise = np.tan(np.radians(19.0))
    grid = terrain_grid(ground(lambda x, y: rise * x), replace(CONFIG, cell_m=1.0), CAMERA)
    has_plane = np.isfinite(grid.slope_rad)  # at the corners less than half of the footprint is known
    assert grid.step_m[has_plane].max() < 0.01
    assert grid.hazard[has_plane].max() < 100


def test_points_beyond_the_range_are_not_used_in_cells_that_reach_beyond() -> None:
    grid = terrain_grid(ground(lambda x, y: 0.0 * x), replace(CONFIG, cell_m=9.9, range_m=0.5), CAMERA)
    assert grid.elevation.count.sum() == (1.0 / SPACING) ** 2


def test_poses_bound_the_range_and_lower_the_sigma() -> None:
    cloud = ground(lambda x, y: 0.0 * x)
    near = terrain_grid(cloud, replace(CONFIG, range_m=1.0), CAMERA)
    assert near.hazard.shape == (21, 21)
    everything = terrain_grid(cloud, replace(CONFIG, range_m=1.0))
    assert everything.hazard.shape == (40, 40)
    known, unknown = (at(grid, grid.elevation.sigma_m, 0.75, 0.75) for grid in (near, everything))
    assert known < unknown == pytest.approx(0.005, rel=0.02)


@pytest.mark.parametrize("change", [{"max_step_m": 0.0}, {"cell_m": -0.1}, {"max_slope_deg": float("nan")}])
def test_a_configuration_that_was_not_checked_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(change))):
        terrain_grid(ground(lambda x, y: 0.0 * x), replace(CONFIG, **change), CAMERA)


def test_the_footprint_has_a_limited_number_of_cells() -> None:
    cloud = ground(lambda x, y: 0.0 * x)
    fine = replace(CONFIG, cell_m=0.01, range_m=0.5)
    with pytest.raises(MappingError, match="radius of 101 cells"):
        terrain_grid(cloud, replace(fine, footprint_radius_m=1.01), CAMERA)
    assert terrain_grid(cloud, replace(fine, footprint_radius_m=1.0), CAMERA).hazard.shape == (101, 101)


@pytest.mark.parametrize("poses", [[], CAMERA])
def test_an_empty_cloud_has_no_covariances(poses: list[Transform]) -> None:
    cloud = ground(lambda x, y: 0.0 * x)
    assert point_covariances(cloud.select(np.zeros(len(cloud), bool)), poses, 400.0).shape == (0, 3, 3)


@pytest.mark.parametrize("is_exact", [True, False])
def test_a_point_at_its_camera_has_no_covariance(*, is_exact: bool) -> None:
    cloud = ground(lambda x, y: 0.0 * x)
    centre = cloud.xyz[0].astype(np.float64) + (0.0 if is_exact else 1e-6)
    at_point = [Transform(np.eye(3), centre)]
    if is_exact:
        with pytest.raises(MappingError, match="at the position of its camera"):
            point_covariances(cloud, at_point, 400.0)
    else:
        assert np.isfinite(point_covariances(cloud, at_point, 400.0)).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-3])
def test_a_sigma_that_is_negative_or_not_finite_is_refused(value: float) -> None:
    cloud = ground(lambda x, y: 0.0 * x)
    sigma = cloud.sigma.copy()
    sigma[7] = value
    wrong = replace(cloud, sigma=sigma)
    with pytest.raises(MappingError, match="sigma of the cloud has values that are negative or not finite"):
        terrain_grid(wrong, CONFIG, CAMERA)
    with pytest.raises(MappingError, match="random_sigma has values that are negative or not finite"):
        terrain_grid(cloud, CONFIG, CAMERA, sigma)
    with pytest.raises(MappingError, match="sigma of the cloud has values that are negative or not finite"):
        point_covariances(wrong, CAMERA, 400.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_point_that_is_not_finite_is_refused(axis: int, value: float) -> None:
    cloud = ground(lambda x, y: 0.0 * x)
    xyz = cloud.xyz.copy()
    xyz[7, axis] = value
    wrong = replace(cloud, xyz=xyz)
    with pytest.raises(MappingError, match="points that are not finite"):
        terrain_grid(wrong, CONFIG, CAMERA)
    with pytest.raises(MappingError, match="points that are not finite"):
        point_covariances(wrong, CAMERA, 400.0)


def test_a_missing_pose_or_sigma_of_a_point_is_refused() -> None:
    cloud = ground(lambda x, y: 0.0 * x)
    second = replace(cloud, pair=np.ones(len(cloud), np.uint8))
    with pytest.raises(MappingError, match="pair index 1, and 1 poses"):
        terrain_grid(second, CONFIG, CAMERA)
    with pytest.raises(MappingError, match="pair index 1, and 1 poses"):
        point_covariances(second, CAMERA, 400.0)
    with pytest.raises(MappingError, match="random_sigma has the shape"):
        terrain_grid(cloud, CONFIG, CAMERA, np.ones(3, np.float32))
    with pytest.raises(MappingError, match="random_sigma has the shape"):
        terrain_grid(cloud, CONFIG, CAMERA, cloud.sigma[:, None])
    with pytest.raises(MappingError, match="random_sigma exceeds the sigma"):
        terrain_grid(cloud, CONFIG, CAMERA, 2.0 * cloud.sigma)
    with pytest.raises(MappingError, match="a Transform is required"):
        terrain_grid(cloud, CONFIG, [None])
    for focal_px in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(MappingError, match="focal_px"):
            point_covariances(cloud, CAMERA, focal_px)
    assert point_covariances(second, CAMERA * 2, 400.0).shape == (len(cloud), 3, 3)
