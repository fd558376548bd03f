"""Keyframes: the first of a window, the next ones in the background, and when one is wanted."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from loc_drive import BLACK, camera_motion, frame_of, pair_of_drive
from made_scene import HEIGHT, LOC_RIG, WIDTH, true_pose

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.tracking import Tracker, TrackingResult
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend

CAMERA = LOC_RIG.camera
BLACK_FRAME = frame_of(StereoPair(0, BLACK, BLACK))
TRACKER = Tracker(LocalisationConfig(), CAMERA)


def begun(config: LocalisationConfig | None = None) -> KeyframeBackend:
    by = KeyframeBackend(LOC_RIG, config or LocalisationConfig(), TRACKER)
    by.begin(frame_of(pair_of_drive(0)), Transform.identity())
    return by


def tracked(by: KeyframeBackend, index: int) -> TrackingResult:
    motion = camera_motion(index)
    start = Pose(motion.rotation, motion.translation)
    return TRACKER.refine(frame_of(pair_of_drive(index)), by.landmarks, start, by.calibration.offset)


def add(by: KeyframeBackend, index: int, result: TrackingResult) -> float:
    assert by.window is not None
    return by.add_keyframe(by.window, frame_of(pair_of_drive(index)), result)


def test_a_window_begins_with_landmarks_on_the_wall_and_one_that_finds_few_does_not_replace_it() -> None:
    by = begun()
    before, landmarks = by.window, by.landmarks
    assert before is not None
    assert len(landmarks.index) > 100
    wall = (true_pose(0) @ LOC_RIG.T_rb_left).apply(landmarks.points)
    assert np.median(np.abs(wall[:, 0] - 3.0)) < 0.05
    assert by.begin(BLACK_FRAME, camera_motion(5)) == 0
    assert (by.window, by.landmarks, by.keyframe_count) == (before, landmarks, 1)


def test_a_keyframe_adds_landmarks_and_drops_outliers() -> None:
    by = begun()
    result = tracked(by, 12)
    assert add(by, 12, result) > 0.0
    assert by.keyframe_count == 2
    kept = result.landmarks.index[result.inliers]
    assert set(kept) <= set(by.landmarks.index)
    assert not set(result.landmarks.index[~result.inliers]) & set(by.landmarks.index)
    assert len(by.landmarks.index) > len(kept)
    assert by.window is not None
    np.testing.assert_allclose(by.window.problem.keyframes.positions[-1], camera_motion(12).translation, atol=0.01)
    assert np.linalg.eigvalsh(by.window.covariance).min() > 0.0
    by.reset()
    assert (by.window, by.keyframe_count, len(by.landmarks.index)) == (None, 0, 0)


def test_a_correction_of_yaw_moves_all_right_observations(monkeypatch: pytest.MonkeyPatch) -> None:
    by = begun()
    result = tracked(by, 12)
    monkeypatch.setattr(by.calibration, "learn_yaw", lambda *_: 0.05)
    add(by, 12, result)
    kept, rows, _ = np.intersect1d(result.landmarks.index, by.landmarks.index, return_indices=True)
    now = by.landmarks.last_seen[np.searchsorted(by.landmarks.index, kept), 2]
    x = (result.observations[rows, 2] - LOC_RIG.cx) / LOC_RIG.fx
    np.testing.assert_allclose(now, result.observations[rows, 2] - 0.05 * (1.0 + x * x), atol=1e-9)


@pytest.mark.parametrize("side", ["left_mask", "right_mask"])
def test_masked_parts_have_no_landmarks(side: str, tmp_path: Path) -> None:
    mask, path = np.full((HEIGHT, WIDTH), 255, np.uint8), str(tmp_path / "mask.png")
    mask[:, : WIDTH // 2] = 0
    cv2.imwrite(path, mask)
    by = begun(LocalisationConfig(**{side: path}, min_tracked=8))  # type: ignore[arg-type]
    column = by.landmarks.last_seen[:, 0 if side == "left_mask" else 2]
    assert len(column) > 20
    assert column.min() > WIDTH // 2 - 1
    cv2.imwrite(path, mask[:3, :4])
    with pytest.raises(ConfigError, match=rf"4 x 3 pixels; give a grey .* of {WIDTH} x {HEIGHT} pixels"):
        begun(LocalisationConfig(left_mask=path))
