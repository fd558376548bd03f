"""The sensor: the effect and the statistics of each part."""

import numpy as np
import pytest

from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.geometry.arrays import FloatImage, GreyImage
from sfr_loc_map.simulation.config import SensorConfig
from sfr_loc_map.simulation.sensor import sensor_image
from sfr_loc_map.suite_names import SIDES, Task

PLAIN = {"blur_px": 0.0, "full_well": 0.0, "read_noise_grey": 0.0}
HALF = np.full((120, 160), 0.5, np.float32)


def image(bright: FloatImage, frame: int, camera: int, **changes: object) -> GreyImage:
    return sensor_image(bright, 7, build(SensorConfig, {**PLAIN, **changes}), Task.LOCALISATION, frame, SIDES[camera])


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


@pytest.mark.parametrize("blur_px", [1.0, 2.0])
def test_a_point_is_spread_to_a_gaussian_of_the_configured_standard_deviation(blur_px: float) -> None:
    point = np.zeros((61, 61), np.float32)
    point[30, 30] = 0.8 * 2.0 * np.pi * blur_px**2  # the maximum of the Gaussian is then 0.8
    spread = image(point, 0, 0, blur_px=blur_px).astype(float)
    offset = np.arange(61.0) - 30.0
    for axis in (0, 1):
        profile = spread.sum(axis=axis)
        assert (profile * offset).sum() == pytest.approx(0.0, abs=1e-9)
        assert np.sqrt((profile * offset**2).sum() / profile.sum()) == pytest.approx(blur_px, rel=0.03)


def test_steps_of_the_exposure_are_common_to_both_cameras_and_a_mismatch_is_constant() -> None:
    dark = np.full((4, 4), 0.2, np.float32)

    def logarithms(camera: int, **changes: float) -> np.ndarray:
        return np.log([image(dark, frame, camera, adc_bits=16, **changes).mean() / 51.0 for frame in range(400)])

    left, right = (logarithms(camera, gain_step=0.2) for camera in (0, 1))
    assert left.std() == pytest.approx(0.2, rel=0.1)
    np.testing.assert_array_equal(left, right)
    left, right = (logarithms(camera, gain_mismatch=0.2) for camera in (0, 1))
    assert (left == 0.0).all()
    assert np.ptp(right) == 0.0
    assert right[0] != 0.0


def test_a_converter_of_few_bits_has_few_grey_levels() -> None:
    ramp = np.linspace(0.0, 1.0, 4096, dtype=np.float32)[None]
    levels = np.unique(image(ramp, 0, 0, adc_bits=4))
    np.testing.assert_array_equal(levels, np.arange(16) * 17)
