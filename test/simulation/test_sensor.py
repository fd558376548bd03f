"""The sensor: the effect and the statistics of each part."""

import numpy as np
import pytest

from sfr_loc_map.config import build
from sfr_loc_map.geometry.arrays import FloatImage, GreyImage
from sfr_loc_map.simulation.config import SensorConfig
from sfr_loc_map.simulation.sensor import sensor_image
from sfr_loc_map.suite_names import Task

PLAIN = {"blur_px": 0.0, "full_well": 0.0, "read_noise_grey": 0.0}
HALF = np.full((120, 160), 0.5, np.float32)


def image(bright: FloatImage, frame: int, camera: int, **changes: object) -> GreyImage:
    return sensor_image(bright, 7, build(SensorConfig, {**PLAIN, **changes}), Task.LOCALISATION, frame, camera)


def test_same_frame_and_camera_same_bytes_others_differ() -> None:
    noisy = {"read_noise_grey": 2.0, "full_well": 9000.0, "gain_step": 0.1}
    first = image(HALF, 3, 1, **noisy)
    assert np.array_equal(first, image(HALF, 3, 1, **noisy))
    assert not np.array_equal(first, image(HALF, 3, 0, **noisy))
    assert not np.array_equal(first, image(HALF, 4, 1, **noisy))


def test_variance_of_photon_noise_is_proportional_to_the_signal() -> None:
    """The photon transfer line: variance in electrons equals the mean in electrons."""
    well = 4000.0
    for level in (0.1, 0.4, 0.8):
        bright = np.full((120, 160), level, np.float32)
        electrons = image(bright, 0, 0, full_well=well, adc_bits=16).astype(float) / 255.0 * well
        quantisation = (well / 255.0) ** 2 / 12.0
        assert electrons.var() - quantisation == pytest.approx(level * well, rel=0.06)
        assert electrons.mean() == pytest.approx(level * well, rel=0.005)
