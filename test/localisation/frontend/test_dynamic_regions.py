"""Regions of the image that do not move with the ground, and landmarks that a pose does not explain."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from loc_drive import frame_of

from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.frontend.dynamic_regions import (
    FIXED_LIFE,
    MIN_MOTION_PX,
    DynamicRegions,
    fixed_correlation,
    project,
    stays,
    unexplained_by,
)
from sfr_loc_map.localisation.frontend.landmarks import BORDER, HostPatches, Landmarks, Patches
from sfr_loc_map.localisation.frontend.patch import HALF, SIDE, LocalPlanes, cut_patches, templates_of
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates
from sfr_loc_map.localisation.frontend.tracking import TrackingResult

UV = np.array([[40.0, 30.0], [90.0, 60.0]])
CAMERA, SHAPE = StereoCamera(200.0, 210.0, 80.0, 60.0, 0.1), (120, 160)


def image(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(100, 140)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return 100 + 30 * smooth / smooth.std()


def cut(source: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(cut_patches(source, UV, HALF)[:, 0])


def added(source: np.ndarray, *, fixed: bool) -> DynamicRegions:
    regions = DynamicRegions((100, 140), 200)
    regions.add(source.astype(np.uint8), UV, np.full(2, fixed), cut(source))
    return regions


def test_what_moved_or_lies_at_the_edge_or_on_a_straight_edge_does_not_stay() -> None:
    source = image()
    assert stays(source, cut(source), UV).all()
    assert stays(0.5 * source + 40, cut(source), UV).all()  # brightness and contrast do not count
    assert not stays(np.roll(source, 2, axis=1), cut(source), UV).any()
    np.testing.assert_array_equal(fixed_correlation(source, cut(source), UV - [UV[0, 0], 0])[0], [-1.0, -1.0])
    edge = np.repeat(source[:, :1], 140, axis=1)
    assert not stays(edge, cut(edge), UV).any()


def test_a_fixed_region_lasts_as_long_as_its_texture() -> None:
    source = image()
    regions = added(source, fixed=True)
    assert regions.mask is not None
    assert (regions.mask[30, 40], regions.mask[5, 5]) == (0, 255)
    for _ in range(2 * FIXED_LIFE):
        regions.update(source.astype(np.uint8), source)
    assert 0.05 < regions.share < 0.3
    for _ in range(FIXED_LIFE):
        regions.update(image(1).astype(np.uint8), image(1))
    assert (regions.mask, regions.share) == (None, 0.0)


@pytest.mark.parametrize("step", [3, -4])
def test_a_moving_region_is_carried_on(step: int) -> None:
    source = image()
    regions, moved = added(source, fixed=False), np.roll(source, step, axis=1)
    regions.update(moved.astype(np.uint8), moved)
    assert regions.mask is not None
    assert np.flatnonzero(regions.mask[30, :65] == 0).mean() == pytest.approx(40 + step, abs=0.6)
    for _ in range(10):
        regions.update(moved.astype(np.uint8), moved)
    assert regions.mask is None


def test_what_is_in_view_and_what_moved_follows_from_the_projections() -> None:
    random, count = np.random.default_rng(0), 400
    uv = np.rint(random.uniform((0, 0), SHAPE[::-1], (count, 2)))
    rotations = np.array([matrix_from_rotvec(0.1 * random.normal(size=3)) for _ in range(count)])
    hosts, rho = Poses(rotations, 0.1 * random.normal(size=(count, 3))), random.uniform(-0.2, 1.0, count)
    rays = np.column_stack((CAMERA.normalised(uv), np.ones(count)))
    fine = templates_of(random.normal(size=(count, 3, SIDE * SIDE)).astype(np.float32))
    rows = np.arange(count)
    landmarks = Landmarks(
        rows,
        LocalPlanes(hosts, uv, rho, np.zeros((count, 2))),
        LandmarkEstimates(hosts, rays, rho, np.zeros((count, 3, 3))),
        Patches((HostPatches(uv, fine, ()),), rows),
        np.zeros((count, 4)),
    )
    pose = Pose(matrix_from_rotvec([0.0, 0.05, 0.02]), np.array([0.1, 0.0, 1.5]))
    grey = random.integers(0, 255, SHAPE).astype(np.uint8)
    frame, none = frame_of(StereoPair(0, grey, grey)), np.zeros(count, np.bool_)
    observations, variance = np.zeros((count, 4)), np.ones((count, 2, 3))
    result = TrackingResult(
        pose, np.eye(6), landmarks, observations, variance, np.full(count, 1e3), none, 0, False, 1.0
    )
    seen = project(pose, landmarks, CAMERA)
    inside = np.all((seen > BORDER) & (seen < [SHAPE[1] - 1 - BORDER, SHAPE[0] - 1 - BORDER]), axis=1)
    moved = ~(np.abs(seen - uv).max(axis=1) < MIN_MOTION_PX)
    assert np.isnan(seen[:, 0]).any()
    assert 0 < inside.sum() < count
    found = unexplained_by(result, frame, CAMERA)
    np.testing.assert_array_equal(found.in_view, inside)
    np.testing.assert_allclose(found.uv, seen, atol=1e-9)
    np.testing.assert_array_equal(found.rows, inside)
    assert not found.fixed.any()

    # what the image shows where it was cut is fixed, if the pose moves it
    reach, smooth = SIDE // 2, frame.left[0].image
    inner = np.flatnonzero(np.all((uv >= reach + 4) & (uv < np.array(SHAPE[::-1]) - reach - 4), axis=1))
    for n in inner:
        column, row = uv[n].astype(int)
        cut_here = smooth[row - reach : row + reach + 1, column - reach : column + reach + 1]
        landmarks.patches[0].values[n, 0] = cut_here.reshape(-1)
    fixed = unexplained_by(result, frame, CAMERA).fixed
    np.testing.assert_array_equal(np.flatnonzero(fixed), inner[moved[inner]])
