"""Drives of the localiser in front of the wall of `made_scene`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future
from functools import cache
from typing import Any

import numpy as np

from helpers.made_scene import HEIGHT, LOC_RIG, PERIOD_NS, START_NS, WIDTH, loc_pair, true_pose
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.localisation.keyframes import KeyframeResult
from sfr_loc_map.localisation.localiser import Localiser

BLACK = np.zeros((HEIGHT, WIDTH), np.uint8)
LOST = np.eye(6) * 9999.0
pair_of_drive = cache(loc_pair)


def drive(count: int = 40) -> list[StereoPair]:
    return [pair_of_drive(index) for index in range(count)]


def localiser(T_ds_rb: Transform | None = None, executor: Executor | None = None) -> Localiser:
    """Return a localiser at the first true pose, or at another one."""
    start = true_pose(0) if T_ds_rb is None else T_ds_rb
    return Localiser(LOC_RIG, LocalisationConfig(), start, executor=executor)


class KeyframesAtOnce(Executor):
    """Makes each keyframe at once, and may change its result or raise an exception in its place."""

    def __init__(self) -> None:
        self.results: list[KeyframeResult] = []  #: Results before their change.
        self.change: Callable[[KeyframeResult], KeyframeResult] = lambda result: result

    def submit(self, make: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.results.append(make(*arguments, **options))
        try:
            future.set_result(self.change(self.results[-1]))
        except np.linalg.LinAlgError as error:
            future.set_exception(error)
        return future


def run(pairs: Iterable[StereoPair], by: Localiser | None = None) -> list[PoseEstimate]:
    by = by or localiser()
    return [by.process(pair) for pair in pairs]


def errors(estimate: PoseEstimate, truth: Transform) -> tuple[float, float]:
    """Return distance, metres, and angle, degrees, between an estimate and the truth."""
    difference = truth.inverse() @ estimate.T_ds_rb
    angle = np.linalg.norm(rotvec_from_matrix(difference.rotation))
    return float(np.linalg.norm(difference.translation)), float(np.degrees(angle))


def black(index: int) -> StereoPair:
    return StereoPair(START_NS + index * PERIOD_NS, BLACK, BLACK)


def noisy(image: np.ndarray, level: float, rng: np.random.Generator) -> np.ndarray:
    """Return an image with noise of so many grey levels."""
    return np.clip(np.rint(image + rng.normal(0, level, image.shape)), 0, 255).astype(np.uint8)
