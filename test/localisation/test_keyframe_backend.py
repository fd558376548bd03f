"""Keyframes: the first of a window, the next ones in the background, and when one is wanted."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from loc_drive import BLACK, pair_of_drive
from made_scene import HEIGHT, LOC_RIG, WIDTH, true_pose

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation import keyframe_backend
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.sparse_stereo import StereoMatches, match_corners
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend

CAMERA = LOC_RIG.camera
BLACK_FRAME = StereoFrame.of(StereoPair(0, BLACK, BLACK))


def backend(config: LocalisationConfig | None = None) -> tuple[KeyframeBackend, Tracker]:
    config = config or LocalisationConfig()
    tracker = Tracker(config, CAMERA)
    return KeyframeBackend(LOC_RIG, config, CAMERA, tracker), tracker


def frame(index: int) -> StereoFrame:
    return StereoFrame.of(pair_of_drive(index))


def camera_motion(index: int) -> Transform:
    """Return the left camera at a pair in that of the first pair."""
    first, now = (true_pose(k) @ LOC_RIG.T_rb_left for k in (0, index))
    return first.inverse() @ now


def tracked(by: KeyframeBackend, tracker: Tracker, index: int) -> TrackingResult:
    start = Pose.of(camera_motion(index))
    return tracker.refine(frame(index), by.landmarks, start, by.calibration.offset)


def test_a_window_begins_with_landmarks_on_the_wall() -> None:
    by, _ = backend()
    assert not by.started
    assert len(by.landmarks) == 0
    found = by.begin(frame(0), Transform.identity())
    assert by.started
    assert found == len(by.landmarks) > 100
    assert by.keyframe_count == 1
    wall = (true_pose(0) @ LOC_RIG.T_rb_left).apply(by.landmarks.points)
    assert np.median(np.abs(wall[:, 0] - 3.0)) < 0.05


@pytest.mark.parametrize(("side", "landmarks", "own_slopes"), [(640, 200, False), (1024, 400, True)])
def test_images_of_a_megapixel_have_more_landmarks_which_tell_their_slopes(
    side: int, landmarks: int, own_slopes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def matched(*args: object, own_slopes: bool) -> StereoMatches:
        seen.append((len(args[2]), own_slopes))  # type: ignore[arg-type]
        return match_corners(*args, own_slopes=own_slopes)  # type: ignore[arg-type]

    monkeypatch.setattr(keyframe_backend, "match_corners", matched)
    rig = replace(LOC_RIG, width=side, height=side)
    noise = np.random.default_rng(1).integers(0, 255, (side, side), np.uint8)
    texture = cv2.GaussianBlur(noise, (0, 0), 2.0) * 2
    pair = StereoPair(0, texture, np.roll(texture, -20, axis=1))
    config = LocalisationConfig(max_features=200)
    tracked = KeyframeBackend(rig, config, CAMERA, Tracker(config, CAMERA))
    assert tracked.begin(StereoFrame.of(pair), Transform.identity()) > 0.8 * landmarks
    [(corners, own)] = seen
    assert corners == pytest.approx(landmarks, rel=0.15)
    assert own is own_slopes


@pytest.mark.parametrize("begun", [False, True])
def test_a_window_that_finds_too_few_landmarks_does_not_replace_the_one_before(begun: bool) -> None:
    by, _ = backend()
    if begun:
        by.begin(frame(0), Transform.identity())
    before, count = by.landmarks, by.keyframe_count
    assert by.begin(BLACK_FRAME, camera_motion(5)) == 0
    assert by.started is begun
    assert by.landmarks is before
    assert by.keyframe_count == count


def test_a_keyframe_tracks_all_landmarks_where_only_some_are_followed() -> None:
    by, tracker = backend()
    by.begin(frame(0), Transform.identity())
    every = tracked(by, tracker, 2)
    some = every.landmarks.subset(np.arange(len(every.landmarks)) % 2 == 0)
    followed = tracker.refine(frame(2), some, every.pose, by.calibration.offset)
    complete = by.complete(frame(2), followed)
    assert len(complete.landmarks) == len(by.landmarks)
    np.testing.assert_allclose(complete.pose.position, every.pose.position, atol=1e-4)
    assert by.complete(frame(2), every) is every
    kept = by.complete(BLACK_FRAME, followed)  # what was tracked is not sought again
    assert kept.inlier_count == followed.inlier_count
    np.testing.assert_allclose(kept.pose.position, followed.pose.position, atol=1e-6)
    seldom = np.where(np.arange(len(some))[:, None] % 8, np.nan, followed.observations)
    doubtful = replace(followed, observations=seldom)
    assert by.complete(BLACK_FRAME, doubtful) is doubtful  # too few of all landmarks are found


def test_a_keyframe_is_wanted_after_some_flow_or_with_few_landmarks_left() -> None:
    by, tracker = backend()
    by.begin(frame(0), Transform.identity())
    assert not by.wants_keyframe(tracked(by, tracker, 1))
    far = tracked(by, tracker, 12)
    assert np.median(far.flow_px) > 0.05 * WIDTH
    assert by.wants_keyframe(far)
    near = tracked(by, tracker, 1)
    few = np.where(np.arange(len(near.chi2_per_dof)) % 2, near.chi2_per_dof, 100.0)
    assert by.wants_keyframe(replace(near, chi2_per_dof=few))


def test_a_keyframe_adds_landmarks_and_drops_outliers() -> None:
    by, tracker = backend()
    by.begin(frame(0), Transform.identity())
    result = tracked(by, tracker, 12)
    assert by.wait() is None
    by.add_keyframe(frame(12), result)
    seconds = by.wait()
    assert seconds is not None
    assert seconds > 0.0
    assert by.wait() is None
    assert by.keyframe_count == 2
    kept = result.landmarks.index[result.inliers]
    assert set(kept) <= set(by.landmarks.index)
    assert not set(result.landmarks.index[~result.inliers]) & set(by.landmarks.index)
    assert len(by.landmarks) > len(kept)
    np.testing.assert_allclose(by.pose.position, camera_motion(12).translation, atol=0.01)
    assert by.covariance.shape == (6, 6)
    assert np.linalg.eigvalsh(by.covariance).min() > 0.0


def test_reset_waits_for_the_keyframe_and_forgets_it() -> None:
    by, tracker = backend()
    by.begin(frame(0), Transform.identity())
    by.add_keyframe(frame(12), tracked(by, tracker, 12))
    by.reset()
    assert by.wait() is None
    assert (by.started, by.keyframe_count, len(by.landmarks)) == (False, 0, 0)


def test_vertical_disparity_is_learnt_and_taken_off_the_observations() -> None:
    """Right images half a pixel too low."""
    by, _ = backend()
    pair, down = pair_of_drive(0), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.5]])
    lower = cv2.warpAffine(pair.right, down, (WIDTH, HEIGHT))
    by.begin(StereoFrame.of(replace(pair, right=lower)), Transform.identity())
    assert by.calibration.offset.v == pytest.approx(0.5, abs=0.05)
    vertical_disparity = by.landmarks.last_seen[:, 3] - by.landmarks.last_seen[:, 1]
    assert np.median(vertical_disparity) == pytest.approx(0.0, abs=0.05)


def test_a_correction_of_yaw_moves_all_right_observations(monkeypatch: pytest.MonkeyPatch) -> None:
    by, tracker = backend()
    by.begin(frame(0), Transform.identity())
    result = tracked(by, tracker, 12)
    monkeypatch.setattr(by.calibration, "learn_yaw", lambda *_: 0.05)
    by.add_keyframe(frame(12), result)
    by.wait()
    kept, rows, _ = np.intersect1d(result.landmarks.index, by.landmarks.index, return_indices=True)[0:3]
    now = by.landmarks.last_seen[np.searchsorted(by.landmarks.index, kept), 2]
    x = (result.observations[rows, 2] - LOC_RIG.cx) / LOC_RIG.fx
    np.testing.assert_allclose(now, result.observations[rows, 2] - 0.05 * (1.0 + x * x), atol=1e-9)


@pytest.mark.parametrize("side", ["left_mask", "right_mask"])
def test_masked_parts_have_no_landmarks(side: str, tmp_path: object) -> None:
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:, : WIDTH // 2] = 0
    cv2.imwrite(f"{tmp_path}/mask.png", mask)
    by, _ = backend(LocalisationConfig(**{side: f"{tmp_path}/mask.png"}, min_tracked=8))
    by.begin(frame(0), Transform.identity())
    column = by.landmarks.last_seen[:, 0 if side == "left_mask" else 2]
    assert len(column) > 20
    assert column.min() > WIDTH // 2 - 1


def test_a_mask_of_another_size_is_refused(tmp_path: object) -> None:
    cv2.imwrite(f"{tmp_path}/mask.png", np.zeros((3, 4), np.uint8))
    with pytest.raises(ConfigError, match=rf"4 x 3 pixels; give a grey .* of {WIDTH} x {HEIGHT} pixels"):
        backend(LocalisationConfig(left_mask=f"{tmp_path}/mask.png"))
