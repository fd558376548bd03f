"""Relocalisation: poses from optical flow and from descriptors, and when to give up."""

from __future__ import annotations

import numpy as np
import pytest
from loc_drive import BLACK, pair_of_drive
from made_scene import HEIGHT, LOC_RIG, WIDTH, true_pose, wall_points

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.feature_detection import find_corners
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend
from sfr_loc_map.localisation.relocalisation import (
    RELOCALISATION_ATTEMPTS,
    RelocalisationKeyframe,
    Relocaliser,
    pnp_from_descriptors,
    pnp_from_optical_flow,
)

CONFIG = LocalisationConfig()
CAMERA = LOC_RIG.camera
MIN_INLIERS = 20
GREY = np.full((HEIGHT, WIDTH), 90, np.uint8)


def true_camera(index: int) -> Transform:
    """Return the left camera in DS."""
    return true_pose(index) @ LOC_RIG.T_rb_left


def corners_of(image: np.ndarray) -> np.ndarray:
    return find_corners(image.astype(np.float32), np.zeros((0, 2)), 400, 20)


def keyframe(index: int = 0) -> RelocalisationKeyframe:
    image = pair_of_drive(index).left
    uv = corners_of(image)
    points = wall_points(true_camera(index), LOC_RIG)[uv[:, 1].astype(int), uv[:, 0].astype(int)]
    return RelocalisationKeyframe(image, uv, points, np.arange(len(uv)))


def frame(index: int, *, right: np.ndarray | None = None) -> StereoFrame:
    pair = pair_of_drive(index)
    return StereoFrame.of(StereoPair(pair.stamp_ns, pair.left, pair.right if right is None else right))


@pytest.fixture
def started() -> tuple[Relocaliser, Tracker, KeyframeBackend]:
    """A relocaliser that knows the first pair of the drive; the world is the first camera."""
    tracker = Tracker(CONFIG, CAMERA)
    backend = KeyframeBackend(LOC_RIG, CONFIG, CAMERA, tracker)
    backend.begin(frame(0), Transform.identity())
    relocaliser = Relocaliser(tracker, CONFIG, CAMERA)
    relocaliser.restart(frame(0).image, backend.landmarks)
    return relocaliser, tracker, backend


@pytest.mark.parametrize("index", [0, 3, 8])
def test_pose_by_optical_flow(index: int) -> None:
    pose = pnp_from_optical_flow(keyframe(), pair_of_drive(index).left, CAMERA, MIN_INLIERS)
    assert pose is not None
    np.testing.assert_allclose(pose.position, true_camera(index).translation, atol=0.02)
    np.testing.assert_allclose(pose.rotation, true_camera(index).rotation, atol=0.01)


def test_pnp_from_descriptors_from_afar() -> None:
    now = true_camera(20)
    left, other = keyframe(), pair_of_drive(20).left
    pose = pnp_from_descriptors(left, other, corners_of(other), CAMERA, 20)
    assert pose is not None
    np.testing.assert_allclose(pose[1], now.translation, atol=0.05)
    np.testing.assert_allclose(pose[0], now.rotation, atol=0.05)
    assert pnp_from_descriptors(left, GREY, np.zeros((0, 2)), CAMERA, 20) is None


def test_no_pose_where_too_few_points_are_usable() -> None:
    known = keyframe()
    points = known.points.copy()
    points[MIN_INLIERS - 1 :, 0] = np.nan
    few = RelocalisationKeyframe(known.image, known.uv, points, known.index)
    assert few.usable.sum() == MIN_INLIERS - 1
    image = pair_of_drive(1).left
    assert pnp_from_optical_flow(few, image, CAMERA, MIN_INLIERS) is None
    assert pnp_from_descriptors(few, image, corners_of(image), CAMERA, MIN_INLIERS) is None


def test_no_pose_by_flow_into_an_image_without_texture() -> None:
    assert pnp_from_optical_flow(keyframe(), GREY, CAMERA, MIN_INLIERS) is None


@pytest.mark.parametrize("index", [2, 6, 20])
def test_lost_tracking_is_recovered_near_and_far(
    started: tuple[Relocaliser, Tracker, KeyframeBackend], index: int
) -> None:
    relocaliser, tracker, backend = started
    result = relocaliser.relocalise(frame(index), backend.landmarks, RightOffset())
    assert result is not None
    assert tracker.trusts(result)
    moved = true_camera(0).inverse() @ true_camera(index)
    np.testing.assert_allclose(result.T_world_left.translation, moved.translation, atol=0.005)


def test_nothing_is_recognised_in_black(started: tuple[Relocaliser, Tracker, KeyframeBackend]) -> None:
    relocaliser, tracker, backend = started
    black = StereoFrame.of(StereoPair(0, BLACK, BLACK))
    result = relocaliser.relocalise(black, backend.landmarks, RightOffset())
    assert result is None or not tracker.trusts(result)


def test_nothing_is_tried_before_the_first_keyframe() -> None:
    tracker = Tracker(CONFIG, CAMERA)
    backend = KeyframeBackend(LOC_RIG, CONFIG, CAMERA, tracker)
    assert Relocaliser(tracker, CONFIG, CAMERA).relocalise(frame(0), backend.landmarks, RightOffset()) is None


def test_the_last_tracked_image_is_the_reference_and_follows_its_keyframe(
    started: tuple[Relocaliser, Tracker, KeyframeBackend],
) -> None:
    relocaliser, tracker, backend = started
    near = frame(4)
    result = relocaliser.relocalise(near, backend.landmarks, RightOffset())
    assert result is not None
    relocaliser.remember(near.image, result)
    backend.add_keyframe(near, result)
    assert backend.wait() is not None
    relocaliser.update(backend.landmarks)
    found = relocaliser.relocalise(frame(9), backend.landmarks, RightOffset())
    assert found is not None
    assert tracker.trusts(found)
    moved = true_camera(0).inverse() @ true_camera(9)
    np.testing.assert_allclose(found.T_world_left.translation, moved.translation, atol=0.005)


def test_good_images_alone_are_counted_before_it_gives_up(
    started: tuple[Relocaliser, Tracker, KeyframeBackend],
) -> None:
    relocaliser, _, backend = started
    black, blinded = StereoFrame.of(StereoPair(0, BLACK, BLACK)), frame(30, right=BLACK)
    for _ in range(2 * RELOCALISATION_ATTEMPTS):
        assert not relocaliser.gives_up(black, backend.landmarks)
        assert not relocaliser.gives_up(blinded, backend.landmarks)
    good = [relocaliser.gives_up(frame(30), backend.landmarks) for _ in range(RELOCALISATION_ATTEMPTS + 1)]
    assert good == [False] * RELOCALISATION_ATTEMPTS + [True]
    relocaliser.recovered()
    assert not relocaliser.gives_up(frame(30), backend.landmarks)
