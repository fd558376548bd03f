"""Sensor model of lens, exposure, noise and converter; docs/simulation.md states the source of each number."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage
from sfr_loc_map.simulation.config import SensorConfig
from sfr_loc_map.simulation.noise import Stream
from sfr_loc_map.suite_names import Task

TASK_SEEDS = {Task.LOCALISATION: 0, Task.MAPPING: 1}  #: Number of a task in random seeds.


def sensor_image(bright: FloatImage, seed: int, config: SensorConfig, task: Task, frame: int, camera: int) -> GreyImage:
    """Return the grey image `(H, W)` of a brightness `(H, W)`, which is a fraction of the full range."""
    number, image = TASK_SEEDS[task], bright.astype(np.float32)
    if config.blur_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), config.blur_px, borderType=cv2.BORDER_REFLECT_101).astype(np.float32)
    both = np.random.default_rng([seed, Stream.EXPOSURE, number, frame]).normal() * config.gain_step
    one = np.random.default_rng([seed, Stream.RIGHT_EXPOSURE, number]).normal() * config.gain_mismatch
    image = image * np.float32(np.exp(both + (one if camera else 0.0)))
    noise = np.random.default_rng([seed, Stream.SENSOR_NOISE, number, frame, camera])
    if config.full_well > 0:
        electrons = np.clip(image, 0.0, 4.0) * config.full_well
        image = image + np.sqrt(electrons) * noise.standard_normal(image.shape, np.float32) / config.full_well
    if config.read_noise_grey > 0:
        image = image + (config.read_noise_grey / 255.0) * noise.standard_normal(image.shape, np.float32)
    top = 2**config.adc_bits - 1
    counts = np.clip(np.rint(image * top), 0, top).astype(np.float32)
    return np.asarray(np.rint(counts * (255.0 / top)), dtype=np.uint8)
