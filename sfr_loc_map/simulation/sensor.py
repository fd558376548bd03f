"""Sensor model of lens, exposure, noise and converter; docs/simulation.md states the source of each number."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage
from sfr_loc_map.simulation.config import SensorConfig
from sfr_loc_map.simulation.noise import Stream
from sfr_loc_map.suite_names import SIDES, Side, Task

TASK_SEEDS = {Task.LOCALISATION: 0, Task.MAPPING: 1}  #: Number of a task in random seeds.
MAX_LIGHT = 4.0
"""Light above this multiple of white is not counted in electrons, so that the noise of a glare is finite."""
WHITE_GREY = 255.0  #: Grey level of the brightness 1 in an image file.


def sensor_image(bright: FloatImage, seed: int, config: SensorConfig, task: Task, frame: int, side: Side) -> GreyImage:
    """Return the grey image `(H, W)` of a brightness `(H, W)`, which is a fraction of the full range.

    `frame` is the number of the pair.
    """
    image = bright.astype(np.float32)
    if config.blur_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), config.blur_px, borderType=cv2.BORDER_REFLECT_101).astype(np.float32)
    image = image * np.float32(_exposure(seed, config, task, frame, side))
    noise = np.random.default_rng([seed, Stream.SENSOR_NOISE, TASK_SEEDS[task], frame, SIDES.index(side)])
    if config.full_well > 0:
        electrons = np.clip(image, 0.0, MAX_LIGHT) * config.full_well
        image = image + np.sqrt(electrons) * noise.standard_normal(image.shape, np.float32) / config.full_well
    if config.read_noise_grey > 0:
        image = image + (config.read_noise_grey / WHITE_GREY) * noise.standard_normal(image.shape, np.float32)
    top = 2**config.adc_bits - 1
    counts = np.clip(np.rint(image * top), 0, top).astype(np.float32)
    return np.asarray(np.rint(counts * (WHITE_GREY / top)), dtype=np.uint8)


def _exposure(seed: int, config: SensorConfig, task: Task, frame: int, side: Side) -> float:
    """Return the factor of the exposure: a random step of each pair, and a constant mismatch of the right camera."""
    pair_rng = np.random.default_rng([seed, Stream.EXPOSURE, TASK_SEEDS[task], frame])
    right_rng = np.random.default_rng([seed, Stream.RIGHT_EXPOSURE, TASK_SEEDS[task]])
    of_pair = pair_rng.normal() * config.gain_step
    of_camera = right_rng.normal() * config.gain_mismatch if side == "right" else 0.0
    return float(np.exp(of_pair + of_camera))
