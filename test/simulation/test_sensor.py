"""The sensor: each part has its own effect and its own statistics."""

import numpy as np
import pytest

from sfr_loc_map.config import build
from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import Task
from sfr_loc_map.simulation.config import SensorConfig
from sfr_loc_map.simulation.sensor import Sensor

RIG = StereoRig(160, 120, 120.0, 120.0, 79.5, 59.5, 0.1)
PLAIN = {"blur_px": 0.0, "full_well": 0.0, "read_noise_grey": 0.0}
HALF = np.full((120, 160), 0.5, np.float32)


def sensor(**changes: object) -> Sensor:
    return Sensor(7, Task.LOCALISATION, build(SensorConfig, {**PLAIN, **changes}), RIG)


def test_same_frame_and_camera_same_bytes_others_differ() -> None:
    noisy = {"read_noise_grey": 2.0, "full_well": 9000.0, "gain_step": 0.1}
    first = sensor(**noisy).image(HALF, 3, 1)
    assert np.array_equal(first, sensor(**noisy).image(HALF, 3, 1))
    assert not np.array_equal(first, sensor(**noisy).image(HALF, 3, 0))
    assert not np.array_equal(first, sensor(**noisy).image(HALF, 4, 1))


def test_rectification_undoes_the_distortion() -> None:
    bent = sensor(distortion=[-0.2, 0.05, 0.001, -0.001])
    v, u = (q.ravel().astype(float) for q in np.mgrid[:120, :160])
    ru, rv = bent.raw_to_rectified(u, v)

    def pattern(x: FloatArray, y: FloatArray) -> FloatImage:
        return (0.5 + 0.2 * np.sin(x / 9.0) * np.cos(y / 7.0)).reshape(120, 160).astype(np.float32)

    assert np.hypot(ru - u, rv - v).max() > 2.0
    got = bent.image(pattern(ru, rv), 0, 0).astype(float)
    error = np.abs(got - 255 * pattern(u, v))[8:-8, 8:-8]
    assert error.max() < 2.0


def test_variance_of_photon_noise_is_proportional_to_the_signal() -> None:
    """The photon transfer line: variance in electrons equals the mean in electrons."""
    well = 4000.0
    camera = sensor(full_well=well, adc_bits=16)
    for level in (0.1, 0.4, 0.8):
        electrons = camera.image(np.full((120, 160), level, np.float32), 0, 0).astype(float) / 255.0 * well
        quantisation = (well / 255.0) ** 2 / 12.0
        assert electrons.var() - quantisation == pytest.approx(level * well, rel=0.06)
        assert electrons.mean() == pytest.approx(level * well, rel=0.005)
