"""Settings of the simulation: a change of each changes what is written."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pytest

from sfr_loc_map.config import build, flatten
from sfr_loc_map.simulation.config import SimulationConfig

pytestmark = pytest.mark.slow

pytest.importorskip("embreex")

SMALL: dict[str, Any] = {
    "terrain.coarseness": 8.0,
    "terrain.rim_radius_m": 20.0,
    "rocks.cover": 0.2,
    "rocks.smallest_m": 0.2,
    "light.sun_azimuth_deg": 210.0,  # behind the rover and low, so that its shadow is in the image
    "light.sun_elevation_deg": 15.0,
    "light.rover_shadow": True,
    "drive.segments": ["straight 1", "turn 30"],
    "drive.pairs": 3,
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
    "drive.pairs": 2,
    "panorama.enabled": False,
    "panorama.pan_deg": [6.0, 10.0],
    "panorama.tilt_deg": [24.0, 25.0],
    "light.rover_shadow": False,
    "light.sun_radius_deg": 3.0,
    "rocks.clear_m": 0.6,
    "rocks.largest_m": 0.5,
    "sensor.samples": 3,
    "sensor.adc_bits": 7,
}
"""Other values of settings that a small increase would make invalid, or whose effect is small in a small image."""
SETTINGS = flatten(build(SimulationConfig, SMALL))


def written(folder: Path, **changes: Any) -> str:
    """Return the hash of the images, tables and rigs of a simulation, without its record of the settings."""
    from sfr_loc_map.simulation.simulate import simulate

    simulate(build(SimulationConfig, {**SMALL, **changes}), folder, workers=1)
    files = sorted(path for path in folder.rglob("*") if path.suffix in (".png", ".csv", ".npy", ".json"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


@pytest.fixture(scope="module")
def unchanged(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("unchanged")
    first = written(folder / "first")
    assert written(folder / "second") == first
    return first


@pytest.mark.parametrize("name", [name for name in SETTINGS if name != "ground.pebbles"])
def test_each_setting_changes_what_is_written(name: str, unchanged: str, tmp_path: Path) -> None:
    value = SETTINGS[name]
    other = OTHER[name] if name in OTHER else value + 8 if isinstance(value, int) else 1.2 * value + 0.05
    assert written(tmp_path / "changed", **{name: other}) != unchanged


def test_pebbles_change_images_whose_pixels_resolve_them(tmp_path: Path) -> None:
    narrow = {"loc.focal_px": 800.0}
    assert written(tmp_path / "few", **narrow) != written(tmp_path / "many", **narrow, **{"ground.pebbles": 0.9})
