"""Relocalisation: poses from optical flow and from descriptors, and when to give up."""

from __future__ import annotations

import numpy as np
import pytest
from loc_drive import BLACK, frame_of, pair_of_drive
from made_scene import HEIGHT, LOC_RIG, WIDTH, true_pose, wall_points

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.feature_detection import find_corners
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend
from sfr_loc_map.localisation.relocalisation import (
    RELOCALISATION_ATTEMPTS,
    Relocaliser,
    pnp_from_descriptors,
    pnp_from_optical_flow,
)

CONFIG, CAMERA, STRAIGHT, ENOUGH = LocalisationConfig(), LOC_RIG.camera, RightOffset(), 20
GREY = np.full((HEIGHT, WIDTH), 90, np.uint8)
BLACK_FRAME = frame_of(StereoPair(0, BLACK, BLACK))


def frame(index: int) -> StereoFrame:
    return frame_of(pair_of_drive(index))


def corners_of(image: np.ndarray) -> np.ndarray:
    return find_corners(image.astype(np.float32), np.zeros((0, 2)), 400, 20)


def known() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the first image with pixels of it and their points."""
    image = pair_of_drive(0).left
    uv = corners_of(image)
    points = wall_points(true_pose(0) @ LOC_RIG.T_rb_left, LOC_RIG)[uv[:, 1].astype(int), uv[:, 0].astype(int)]
    return image, uv, points


@pytest.fixture
def started() -> tuple[Relocaliser, KeyframeBackend]:
    """A relocaliser that knows the first pair of the drive; the world is the first camera."""
    tracker = Tracker(CONFIG, CAMERA)
    backend = KeyframeBackend(LOC_RIG, CONFIG, tracker)
    relocaliser = Relocaliser(tracker, CONFIG, CAMERA)
    assert relocaliser.relocalise(frame(0), backend.landmarks, STRAIGHT) is None
    backend.begin(frame(0), Transform.identity())
    relocaliser.restart(frame(0).image, backend.landmarks)
    return relocaliser, backend


@pytest.mark.parametrize(("index", "by_flow"), [(3, True), (8, True), (20, False)])
def test_poses_by_flow_and_from_afar_by_descriptors(index: int, by_flow: bool) -> None:
    image, truth = pair_of_drive(index).left, true_pose(index) @ LOC_RIG.T_rb_left
    if by_flow:
        pose = pnp_from_optical_flow(*known(), image, CAMERA, ENOUGH)
    else:
        pose = pnp_from_descriptors(*known(), image, corners_of(image), CAMERA, ENOUGH)
    assert pose is not None
    np.testing.assert_allclose(pose.position, truth.translation, atol=0.02 if by_flow else 0.05)
    np.testing.assert_allclose(pose.rotation, truth.rotation, atol=0.01 if by_flow else 0.05)


def test_no_pose_where_too_few_points_are_usable_or_nothing_is_seen() -> None:
    before, uv, points = known()
    few, image = (before, uv[: ENOUGH - 1], points[: ENOUGH - 1]), pair_of_drive(1).left
    assert pnp_from_optical_flow(*few, image, CAMERA, ENOUGH) is None
    assert pnp_from_descriptors(*few, image, corners_of(image), CAMERA, ENOUGH) is None
    assert pnp_from_optical_flow(*known(), GREY, CAMERA, ENOUGH) is None
    assert pnp_from_descriptors(*known(), GREY, np.zeros((0, 2)), CAMERA, ENOUGH) is None


def test_good_images_alone_are_counted_before_it_gives_up(started: tuple[Relocaliser, KeyframeBackend]) -> None:
    relocaliser, backend = started
    blinded = frame(30)._replace(right=BLACK_FRAME.right)
    for _ in range(2 * RELOCALISATION_ATTEMPTS):
        assert not relocaliser.gives_up(BLACK_FRAME, backend.landmarks)
        assert not relocaliser.gives_up(blinded, backend.landmarks)
    good = [relocaliser.gives_up(frame(30), backend.landmarks) for _ in range(RELOCALISATION_ATTEMPTS + 1)]
    assert good == [False] * RELOCALISATION_ATTEMPTS + [True]
