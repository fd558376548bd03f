"""The ground and its rocks: lawful numbers, no cracks, no tiling."""

import numpy as np
import pytest

from sfr_loc_map.simulation.config import GroundConfig, RockConfig, TerrainConfig
from sfr_loc_map.simulation.mesh import CELLS, ground_mesh
from sfr_loc_map.simulation.noise import value2, value3
from sfr_loc_map.simulation.rocks import place_rocks, rock_mesh, rocks_per_area
from sfr_loc_map.simulation.terrain import Terrain, materials


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    return Terrain.make(3, TerrainConfig(), GroundConfig())


def test_rock_cover_is_that_of_the_law() -> None:
    """The areas of all rocks above D add up to k exp(-q D), here for k = 5 % (Golombek and Rapp 1997)."""
    diameters = np.geomspace(0.1, 5.0, 20000)
    numbers = rocks_per_area(diameters, 0.05)
    areas = 0.25 * np.pi * (0.5 * (diameters[1:] + diameters[:-1])) ** 2 * -np.diff(numbers)
    assert areas.sum() == pytest.approx(0.05 * np.exp(-(1.79 + 0.152 / 0.05) * 0.1), rel=5e-3)


def test_placed_rocks_follow_the_law(terrain: Terrain) -> None:
    way = np.array([[0.0, 0.0]])
    rocks = place_rocks(1, RockConfig(smallest_m=0.1, clear_m=10.0), terrain, way, 0.7)
    near = (rocks.distances < 8.0) & (rocks.diameters < 0.2)
    expected = np.pi * 8.0**2 * -np.diff(rocks_per_area(np.array([0.1, 0.2]), 0.05))[0]
    assert near.sum() == pytest.approx(expected, abs=4 * np.sqrt(expected))


def test_large_rocks_are_kept_off_the_way(terrain: Terrain) -> None:
    way = np.column_stack((np.linspace(0, 10, 40), np.zeros(40)))
    rocks = place_rocks(1, RockConfig(cover=0.2), terrain, way, 0.7)
    large = rocks.diameters > 0.12
    assert large.sum() > 100
    assert (rocks.distances[large] - 0.5 * rocks.diameters[large]).min() > 0.7


def test_rocks_are_solids_that_reach_into_the_ground(terrain: Terrain) -> None:
    config = RockConfig(smallest_m=0.2)
    rocks = place_rocks(2, config, terrain, np.array([[0.0, 0.0]]), 0.7)
    mesh = rock_mesh(2, config, rocks)
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # closed
    for number in range(0, len(rocks.diameters), 17):
        z = mesh.vertices[mesh.triangles[mesh.objects == number].ravel(), 2]
        assert z.min() < rocks.centres[number, 2] < z.max()
        assert np.ptp(z) < 1.3 * rocks.diameters[number]


def test_ground_has_no_cracks(terrain: Terrain) -> None:
    """Every edge that only one triangle has lies on an edge of the neighbouring tile, or at the rim of the world."""
    mesh = ground_mesh(terrain, np.array([[0.0, 0.0], [2.0, 1.0]]))
    keys = np.unique(mesh.vertices, axis=0, return_inverse=True)[1].reshape(-1)
    edges = np.sort(keys[mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)], axis=1)
    _unique, first, counts = np.unique(edges, axis=0, return_index=True, return_counts=True)
    places = mesh.vertices[mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1)].reshape(-1, 2, 3)[first[counts == 1]]
    rim = np.abs(places[..., :2] - places[..., :2].mean(axis=(0, 1))).max(axis=(1, 2)) > 500
    middle, length = places.mean(axis=1)[~rim], np.abs(places[:, 0] - places[:, 1])[~rim, :2].max(axis=1)
    assert len(middle) > CELLS  # tiles of different size meet
    lines: dict[tuple[int, float], list[tuple[float, float, float, float]]] = {}
    for a, b in places[~rim]:
        axis = 0 if a[0] == b[0] else 1
        low, high = sorted((tuple(a), tuple(b)), key=lambda p: p[1 - axis])
        lines.setdefault((axis, low[axis]), []).append((low[1 - axis], high[1 - axis], low[2], high[2]))
    assert length.max() > length.min()
    for segments in lines.values():
        array = np.array(segments)
        size = array[:, 1] - array[:, 0]
        fine, coarse = array[size < size.max() * 0.75], array[size >= size.max() * 0.75]
        for x0, x1, z0, z1 in fine[:50]:
            over = coarse[(coarse[:, 0] <= x0) & (coarse[:, 1] >= x1)]
            if len(over):
                c0, c1, h0, h1 = over[0]
                on = np.interp([x0, x1], [c0, c1], [h0, h1])
                assert np.allclose(on, (z0, z1), atol=2e-5)


def test_noise_is_smooth_and_its_gradient_right() -> None:
    rng = np.random.default_rng(0)
    seed, step = np.uint32(9), 1e-6
    for x, y, z in rng.uniform(-50, 50, (200, 3)):
        v, gx, gy = value2(x, y, seed)
        assert -1 <= v <= 1
        assert (value2(x + step, y, seed)[0] - v) / step == pytest.approx(gx, abs=1e-3)
        assert (value2(x, y + step, seed)[0] - v) / step == pytest.approx(gy, abs=1e-3)
        w, _, _, gz = value3(x, y, z, seed)
        assert (value3(x, y, z + step, seed)[0] - w) / step == pytest.approx(gz, abs=1e-3)


def test_ground_does_not_repeat(terrain: Terrain) -> None:
    """No shift of up to 30 m brings the relief back."""
    grid = np.arange(0, 64, 0.25)
    x, y = (q.ravel() for q in np.meshgrid(grid, grid))
    z = terrain.height(x, y, np.full(len(x), 0.1)).reshape(len(grid), -1)
    spectrum = np.fft.fft2(z - np.mean(z))
    correlation = np.fft.ifft2(np.abs(spectrum) ** 2).real
    correlation /= correlation[0, 0]
    assert np.abs(correlation[40:-40, 40:-40]).max() < 0.8


def test_materials_share_the_ground() -> None:
    shares = np.array([0.5, 0.2])
    rng = np.random.default_rng(1)
    found = np.array([materials(x, y, shares, np.uint32(4)) for x, y in rng.uniform(-200, 200, (4000, 2))])
    assert np.allclose(found.sum(axis=1), 1.0)
    assert (found >= 0).all()
    assert 0.1 < found[:, 2].mean() < 0.35
    assert 0.25 < found[:, 1].mean() < 0.6
