"""The mapper's parameters: names and ranges are public."""

import pytest

from sfr_loc_map.config import build, flatten
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig


def test_names_and_defaults() -> None:
    found = flatten(MappingConfig())
    assert {name: value for name, value in found.items() if not name.startswith("terrain.")} == {
        "min_range_m": 0.9,
        "max_range_m": 40.0,
        "refine_poses": False,
        "calibration.yaw_deg": 0.01,
        "calibration.pitch_deg": 0.01,
        "calibration.roll_deg": 0.01,
        "calibration.focal_share": 0.001,
        "calibration.baseline_share": 0.001,
    }
    assert MAX_PAIRS == 3


@pytest.mark.parametrize(("name", "value"), [("min_range_m", 0.01), ("max_range_m", 0.0), ("refine_poses", 2.5)])
def test_values_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=name):
        build(MappingConfig, {name: value})
