"""The ground truth is exact: on the ray of its pixel, on the surface, and at the matching pixel of the right image."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.world import MaskBit, World
from sfr_loc_map.suite_names import SIDES, Task

pytestmark = pytest.mark.slow

pytest.importorskip("embreex")

QUIET = {"sensor__full_well": 0.0, "sensor__read_noise_grey": 0.0, "sensor__samples": 4}


@pytest.fixture(scope="module")
def world(config: Callable[..., SimulationConfig]) -> World:
    return World(Plan.make(config(panorama__enabled=True, drive__enabled=False, **QUIET)))


def left_points(world: World, truth: FloatImage) -> FloatArray:
    rig = world.plan.rig(Task.MAPPING)
    return (world.plan.lm_pose(0) @ rig.T_sb_left).inverse().apply(truth.reshape(-1, 3)).reshape(truth.shape)


@pytest.mark.clause("3.2.7.2")
def test_truth_reprojects_on_its_own_pixel_centre(world: World) -> None:
    truth, _ = world.truth(0)
    rig = world.plan.rig(Task.MAPPING)
    points = left_points(world, truth)
    v, u = np.mgrid[: rig.height, : rig.width]
    seen = np.isfinite(points[..., 2])
    assert seen.mean() > 0.5
    du = rig.fx * points[..., 0] / points[..., 2] + rig.cx - u
    dv = rig.fy * points[..., 1] / points[..., 2] + rig.cy - v
    assert np.abs(du[seen]).max() < 1e-3
    assert np.abs(dv[seen]).max() < 1e-3


def shift_between(world: World) -> FloatArray:
    """Gradient-weighted (Lucas-Kanade) shift along rows and columns, pixels, between the left image and the right one
    warped by the truth."""
    truth, mask = world.truth(0)
    rig = world.plan.rig(Task.MAPPING)
    left, right = (world.brightness(Task.MAPPING, 0, side) * 255 for side in SIDES)
    disparity = (rig.fx * rig.baseline_m / left_points(world, truth)[..., 2]).astype(np.float32)
    v, u = np.mgrid[: rig.height, : rig.width].astype(np.float32)
    good = cv2.erode(
        ((mask & (MaskBit.SKY | MaskBit.OCCLUDED | MaskBit.SHADOW)) == 0).astype(np.uint8), np.ones((7, 7))
    ).astype(bool)
    good &= np.nan_to_num(disparity) > 3
    assert good.sum() > 5000

    def warped(du: float, dv: float) -> FloatImage:
        return cv2.remap(right, u - disparity + du, v + dv, cv2.INTER_CUBIC)

    slope_u = 0.5 * (warped(0.5, 0) - warped(-0.5, 0) + np.gradient(left, axis=1))[good]
    slope_v = 0.5 * (warped(0, 0.5) - warped(0, -0.5) + np.gradient(left, axis=0))[good]
    slopes = np.stack((slope_u, slope_v), axis=1)
    return np.asarray(np.linalg.lstsq(slopes, (left - warped(0, 0))[good], rcond=None)[0])


def test_right_image_shows_the_truth_where_it_says(world: World) -> None:
    assert np.abs(shift_between(world)).max() < 0.02
