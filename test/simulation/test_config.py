"""Settings of the simulation: each setting has an effect on the files."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

import pytest

from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.jobs import lists_of, render_jobs, rendered
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.world import World
from sfr_loc_map.suite_names import Task

pytestmark = pytest.mark.slow

pytest.importorskip("embreex")

SMALL: dict[str, Any] = {
    "terrain.coarseness": 64.0,
    "terrain.rim_radius_m": 20.0,
    "rocks.cover": 0.06,
    "rocks.smallest_m": 0.4,
    "light.sun_azimuth_deg": 210.0,  # behind the rover and low, so that its shadow is in the image
    "light.sun_elevation_deg": 15.0,
    "light.rover_shadow": True,
    "drive.segments": ["straight 1", "turn 30"],
    "drive.pairs": 2,
    "panorama.enabled": True,
    "panorama.pan_deg": [5.0, 9.0],
    "panorama.tilt_deg": [25.0, 25.0],
    **{f"{rig}.{name}": value for rig in ("loc", "nav") for name, value in (("width", 48), ("height", 40))},
    "loc.focal_px": 40.0,
    "nav.focal_px": 40.0,
    "sensor.samples": 2,
    "sensor.exposure_s": 0.01,
}
OTHER: dict[str, Any] = {
    "drive.enabled": False,
    "drive.segments": ["straight 2"],
    "drive.pairs": 3,
    "panorama.enabled": False,
    "panorama.pan_deg": [6.0, 10.0],
    "panorama.tilt_deg": [24.0, 25.0],
    "light.rover_shadow": False,
    "light.sun_radius_deg": 3.0,
    "terrain.coarseness": 60.0,
    "rocks.largest_m": 0.5,
    "sensor.samples": 3,
    "sensor.adc_bits": 7,
}
"""Other values of settings that a small increase would make invalid, or whose effect is small in a small image."""
WORLDS: dict[str, tuple[float, dict[str, float]]] = {
    "ground.pebbles": (0.9, {"loc.focal_px": 800.0}),  # pixels that resolve them
    "rocks.clear_m": (
        0.6,
        {"rocks.cover": 0.2, "rocks.smallest_m": 0.2, "drive.speed_m_s": 2.0},
    ),  # rocks on a path of 1 m
}
"""Other values of settings whose effect needs another world, with its settings."""
SETTINGS = flatten(build(SimulationConfig, SMALL))


def contents(**changes: Any) -> Iterator[bytes]:
    """Yield the contents of the files of a simulation but its settings, the lists before the images."""
    plan = Plan.make(build(SimulationConfig, {**SMALL, **changes}))
    for task in Task:
        if plan.count(task):
            yield from lists_of(plan, task).values()
    world = World(plan)
    for job in render_jobs(plan):
        yield from rendered(world, job)


def differ(some: Iterator[bytes], others: Iterator[bytes]) -> bool:
    """Tell whether two simulations differ in any file; none is rendered after the first that differs."""
    return any(one != other for one, other in zip_longest(some, others))


@pytest.fixture(scope="module")
def unchanged() -> list[bytes]:
    return list(contents())


def test_same_settings_write_the_same(unchanged: list[bytes]) -> None:
    assert not differ(iter(unchanged), contents())


@pytest.mark.parametrize("name", [name for name in SETTINGS if name not in WORLDS])
def test_each_setting_changes_what_is_written(name: str, unchanged: list[bytes]) -> None:
    value = SETTINGS[name]
    other = OTHER[name] if name in OTHER else value + 8 if isinstance(value, int) else 1.2 * value + 0.05
    assert differ(iter(unchanged), contents(**{name: other}))


@pytest.mark.parametrize("name", WORLDS)
def test_setting_changes_what_is_written_of_its_world(name: str) -> None:
    other, world = WORLDS[name]
    assert differ(contents(**world), contents(**world, **{name: other}))
