"""Rocks: their number by size follows the distribution of Golombek and Rapp, and their poses the configuration."""

import numpy as np
import pytest
from scipy.integrate import quad

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.simulation.config import GroundConfig, ReliefConfig, RockConfig
from sfr_loc_map.simulation.ground_mesh import Mesh, path_distance
from sfr_loc_map.simulation.rocks import Rocks, place_rocks, rock_meshes, rocks_per_area
from sfr_loc_map.simulation.terrain import Terrain

PATH = np.column_stack((np.arange(0.0, 3.1, 0.3), np.zeros(11)))
TERRAIN = Terrain.make(3, ReliefConfig(), GroundConfig())
HALF_WIDTH_M = 0.7


def number_per_area(smallest_m: float, largest_m: float, cover: float) -> float:
    """Integrate -dF / (pi D^2 / 4) of F = k exp(-q D), 1 / m^2."""
    q = 1.79 + 0.152 / cover
    return quad(lambda d: cover * q * np.exp(-q * d) / (0.25 * np.pi * d**2), smallest_m, largest_m)[0]


def test_rock_cover_is_that_of_the_law() -> None:
    """The areas of all rocks above D add up to k exp(-q D), here for k = 5 % (Golombek and Rapp 1997)."""
    diameters = np.geomspace(0.1, 5.0, 20000)
    numbers = rocks_per_area(diameters, 0.05)
    areas = 0.25 * np.pi * (0.5 * (diameters[1:] + diameters[:-1])) ** 2 * -np.diff(numbers)
    assert areas.sum() == pytest.approx(0.05 * np.exp(-(1.79 + 0.152 / 0.05) * 0.1), rel=5e-3)


@pytest.mark.parametrize(("smallest_m", "largest_m"), [(0.15, 1.5), (0.3, 0.5)])
def test_the_number_of_placed_rocks_is_that_of_the_law(smallest_m: float, largest_m: float) -> None:
    """Between 2 and 12 m from a path of 3 m there are 6 (12 - 2) + pi (12^2 - 2^2) m^2."""
    config = RockConfig(cover=0.2, smallest_m=smallest_m, largest_m=largest_m)
    found = [place_rocks(seed, config, TERRAIN, PATH, HALF_WIDTH_M) for seed in range(6)]
    inside = [path_distance(rocks.centres[:, :2], PATH) for rocks in found]
    count = sum(int(((distance > 2.0) & (distance < 12.0)).sum()) for distance in inside)
    expected = 6 * number_per_area(smallest_m, largest_m, 0.2) * (6.0 * 10.0 + np.pi * (144.0 - 4.0))
    assert expected > 500
    assert abs(count - expected) < 4.0 * np.sqrt(expected)
    diameters = np.concatenate([rocks.diameters for rocks in found])
    assert (diameters >= smallest_m).all()
    assert (diameters <= largest_m).all()


def test_the_path_is_free_of_rocks_above_the_configured_diameter() -> None:
    config = RockConfig(cover=0.3, smallest_m=0.1, largest_m=1.5, clear_m=0.2)
    rocks = place_rocks(1, config, TERRAIN, PATH, HALF_WIDTH_M)
    gap = path_distance(rocks.centres[:, :2], PATH) - HALF_WIDTH_M - 0.5 * rocks.diameters
    assert (gap[rocks.diameters >= 0.2] > 0.0).all()
    assert (gap[rocks.diameters < 0.2] < 0.0).any()


def vertices_of(meshes: list[Mesh], number: int) -> FloatArray:
    """Return the vertices of a rock."""
    mesh = Mesh.join(meshes)
    return mesh.vertices[np.unique(mesh.triangles[mesh.objects == number])].astype(float)


@pytest.mark.parametrize("buried", [0.2, 0.5])
def test_rocks_are_buried_by_the_configured_fraction_of_their_height(buried: float) -> None:
    """The buried fraction is limited to 0.05 to 0.85, which moves the mean by less than 0.02."""
    count = 300
    diameters = np.linspace(0.1, 1.0, count)
    centres = np.column_stack((np.arange(count) * 3.0, np.zeros(count), np.full(count, 7.0)))
    meshes = rock_meshes(5, RockConfig(buried=buried), Rocks(centres, diameters, np.full(count, 30.0)))
    fractions = []
    for number in range(0, count, 3):
        offsets = vertices_of(meshes, number) - centres[number]
        assert np.ptp(offsets, axis=0).max() <= 1.001 * diameters[number]
        low, high = offsets[:, 2].min(), offsets[:, 2].max()
        fractions.append(-low / (high - low))
    assert np.mean(fractions) == pytest.approx(buried, abs=0.06)
    assert np.std(fractions) == pytest.approx(0.15, abs=0.04)
