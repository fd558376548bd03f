"""The ground and its rocks: numbers by the laws, no cracks, no tiling."""

import numpy as np
import pytest

from sfr_loc_map.simulation.config import GroundConfig, ReliefConfig
from sfr_loc_map.simulation.ground_mesh import CELLS, FINEST_M, ground_mesh
from sfr_loc_map.simulation.rocks import rocks_per_area
from sfr_loc_map.simulation.terrain import Terrain


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    return Terrain.make(3, ReliefConfig(), GroundConfig())


def test_rock_cover_is_that_of_the_law() -> None:
    """The areas of all rocks above D add up to k exp(-q D), here for k = 5 % (Golombek and Rapp 1997)."""
    diameters = np.geomspace(0.1, 5.0, 20000)
    numbers = rocks_per_area(diameters, 0.05)
    areas = 0.25 * np.pi * (0.5 * (diameters[1:] + diameters[:-1])) ** 2 * -np.diff(numbers)
    assert areas.sum() == pytest.approx(0.05 * np.exp(-(1.79 + 0.152 / 0.05) * 0.1), rel=5e-3)


@pytest.mark.slow
def test_ground_has_no_cracks(terrain: Terrain) -> None:
    """Every edge that only one triangle has lies on an edge of the neighbouring tile, or at the rim of the world."""
    mesh = ground_mesh(terrain, np.array([[0.0, 0.0], [2.0, 1.0]]))
    steps = np.rint((mesh.vertices[:, :2] - mesh.vertices[:, :2].min(axis=0)) / FINEST_M).astype(np.uint64)
    height_bits = np.ascontiguousarray(mesh.vertices[:, 2]).view(np.uint32).astype(np.uint64)
    columns = np.unique(steps[:, 0] * 65537 + steps[:, 1], return_inverse=True)[1].astype(np.uint64)
    keys = np.unique((columns << 32) + height_bits, return_inverse=True)[1]
    edges = np.sort(keys[mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)], axis=1)
    _unique, first, counts = np.unique(edges[:, 0] * len(keys) + edges[:, 1], return_index=True, return_counts=True)
    ends = mesh.vertices[mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1)].reshape(-1, 2, 3)[first[counts == 1]]
    rim = np.abs(ends[..., :2] - ends[..., :2].mean(axis=(0, 1))).max(axis=(1, 2)) > 500
    middle, length = ends.mean(axis=1)[~rim], np.abs(ends[:, 0] - ends[:, 1])[~rim, :2].max(axis=1)
    assert len(middle) > CELLS  # tiles of different size meet
    assert length.max() > length.min()
    finest = length == length.min()
    for (a, b), x in zip(ends[~rim][finest][:200], middle[finest][:200], strict=True):
        axis = 0 if a[0] == b[0] else 1  # the edges of coarser tiles on the same line that cover it
        others = ends[~rim][length > length.min()]
        beside = (others[:, :, axis] == a[axis]).all(axis=1)
        low, high = others[..., 1 - axis].min(axis=1), others[..., 1 - axis].max(axis=1)
        for c, d in others[beside & (low <= x[1 - axis]) & (x[1 - axis] <= high)]:
            share = (np.array([a, b])[:, 1 - axis] - c[1 - axis]) / (d[1 - axis] - c[1 - axis])
            assert np.allclose(c[2] + share * (d[2] - c[2]), (a[2], b[2]), atol=2e-5)


def flat(**changes: float) -> Terrain:
    level = {"relief_m": 0.0, "hills_m": 0.0, "ripple_height_m": 0.0, "crater_density": 0.0}
    return Terrain.make(3, ReliefConfig(**(level | changes)), GroundConfig(gravel=0.0, bedrock=0.0))


def heights(terrain: Terrain, x: np.ndarray, y: np.ndarray, spacing: float = 0.02) -> np.ndarray:
    return terrain.height(x.astype(float).copy(), y.astype(float).copy(), np.full(len(x), spacing))


@pytest.mark.clause("3.2.7.1")
def test_slope_is_a_plane_that_rises_to_the_east() -> None:
    x, y = np.random.default_rng(0).uniform(-50, 50, (2, 200))
    assert np.allclose(heights(flat(slope_deg=10.0), x, y), np.tan(np.radians(10.0)) * x, atol=1e-12)


def test_large_crater_is_a_bowl_with_a_rim_around_its_centre() -> None:
    """Floor 0.24 radii deep at the centre, rim 0.07 radii high at the radius, level beyond 2.2 radii."""
    radius, x0, y0 = 10.0, 4.0, -3.0
    crater = flat(rim_radius_m=radius, rim_x_m=x0, rim_y_m=y0)
    angle = np.linspace(0, 2 * np.pi, 9)
    for r, height in ((0.0, -0.24), (1.02, 0.07), (2.3, 0.0)):
        z = heights(crater, x0 + r * radius * np.cos(angle), y0 + r * radius * np.sin(angle))
        assert np.allclose(z, height * radius, atol=0.012 * radius)
        assert np.ptp(z) < 1e-9
