"""The grid of cells keeps planes under down- and upsampling, keeps edges, and fills holes from the background."""

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.disparity_grid import (
    cells_from_pixels,
    edge_preserving_mean,
    fill_occlusions,
    pixels_from_cells,
)

F = np.float32
JUMP = F(1.0)
NAN = np.nan


def plane(rows: int, cols: int, slope_u: float, slope_v: float, scale: float = 1.0, offset: float = 0.0) -> np.ndarray:
    """Return `20 + slope_u u + slope_v v` at `u = scale j + offset`, v likewise."""
    v, u = np.mgrid[:rows, :cols] * scale + offset
    return (20.0 + slope_u * u + slope_v * v).astype(F)


SLOPES = [(0.0, 0.0), (0.3, 0.0), (0.0, -0.3), (0.11, 0.17), (-0.2, 0.05)]


@pytest.mark.parametrize(("slope_u", "slope_v"), SLOPES)
def test_planes_are_kept_from_pixels_to_cells(slope_u: float, slope_v: float) -> None:
    cells = cells_from_pixels(plane(16, 20, slope_u, slope_v), JUMP)
    np.testing.assert_allclose(cells, plane(8, 10, slope_u, slope_v, 2.0, 0.5), atol=1e-5)


@pytest.mark.parametrize(("slope_u", "slope_v"), SLOPES)
def test_planes_are_kept_from_cells_to_pixels(slope_u: float, slope_v: float) -> None:
    pixels = pixels_from_cells(plane(8, 10, slope_u, slope_v, 2.0, 0.5), JUMP)
    np.testing.assert_allclose(pixels[1:-1, 1:-1], plane(16, 20, slope_u, slope_v)[1:-1, 1:-1], atol=1e-5)


@pytest.mark.parametrize(("slope_u", "slope_v"), SLOPES)
def test_planes_are_kept_by_the_mean(slope_u: float, slope_v: float) -> None:
    cells = plane(16, 20, slope_u, slope_v)
    mean = edge_preserving_mean(cells, 2, F(5.0))
    np.testing.assert_allclose(mean[2:-2, 2:-2], cells[2:-2, 2:-2], atol=1e-5)


def test_a_cell_belongs_to_its_nearest_surface() -> None:
    pixels = np.array([[10.0, 4.0, NAN, NAN], [10.5, NAN, NAN, NAN]], F)
    np.testing.assert_array_equal(cells_from_pixels(pixels, JUMP), np.array([[10.25, NAN]], F))


def test_nothing_is_interpolated_across_a_jump() -> None:
    cells = np.full((6, 8), 5.0, F)
    cells[:, 4:] = 9.0
    pixels = pixels_from_cells(cells, JUMP)
    np.testing.assert_array_equal(pixels[:, :8], 5.0)
    np.testing.assert_array_equal(pixels[:, 8:], 9.0)
    np.testing.assert_array_equal(edge_preserving_mean(cells, 3, JUMP), cells)


def test_the_mean_reduces_noise() -> None:
    cells = np.random.default_rng(0).normal(10.0, 0.05, (40, 40)).astype(F)
    mean = edge_preserving_mean(cells, 2, JUMP)
    assert mean[2:-2, 2:-2].std() == pytest.approx(0.05 / 5.0, rel=0.15)
    assert mean.mean() == pytest.approx(10.0, abs=0.003)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ([8.0, NAN, NAN, 5.0], [8.0, 5.0, 5.0, 5.0]),
        ([5.0, NAN, NAN, 8.0], [5.0, 5.0, 5.0, 8.0]),
        ([NAN, 7.0, 6.0, NAN], [7.0, 7.0, 6.0, 6.0]),
        ([NAN, NAN, NAN, NAN], [0.0, 0.0, 0.0, 0.0]),
        ([1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 3.0, 4.0]),
    ],
)
def test_holes_take_the_farther_neighbour(row: list[float], expected: list[float]) -> None:
    np.testing.assert_array_equal(fill_occlusions(np.array([row], F)), np.array([expected], F))
