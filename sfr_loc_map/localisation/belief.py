"""Whether a tracking result is to be believed, and why not."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.estimate import StateReason
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult
from sfr_loc_map.localisation.ground_motion import GroundMotionFinder
from sfr_loc_map.localisation.pose_track import PoseTrack
from sfr_loc_map.localisation.torn_images import Wholeness


def disbelief(
    frame: StereoFrame,
    result: TrackingResult,
    tracker: Tracker,
    track: PoseTrack,
    calibration: OnlineCalibration,
) -> StateReason | None:
    """Return why the pose that was found in a pair is not to be believed, None where it is."""
    if not tracker.trusts(result):
        return blindness(frame)
    finite = are_finite(*result.pose, result.information) and np.linalg.slogdet(result.information)[0] > 0.0
    if not (finite and track.plausible(frame.stamp_ns, result.T_world_left)):
        return StateReason.IMPLAUSIBLE_MOTION
    if tracker.left_right_swapped(frame, result, calibration.offset):
        return StateReason.NO_STEREO
    return None


def blindness(frame: StereoFrame) -> StateReason:
    """Return why a pair gives too few landmarks."""
    textured = frame.left_is_textured and frame.right_is_textured
    return StateReason.FEW_LANDMARKS if textured else StateReason.UNTEXTURED_IMAGES


def reason_to_doubt(ground: GroundMotionFinder, calibration: OnlineCalibration, *, early: bool) -> StateReason | None:
    """Return why a pose that was found in fresh images is doubted, None where it is not.

    Args:
        ground: What it found in the pair.
        calibration: What is known of the right camera.
        early: Whether the window is of those that begin after an unseen motion.
    """
    return first_of(
        (ground.wholeness is not Wholeness.WHOLE, StateReason.TORN_IMAGES),
        (early, StateReason.UNSEEN_MOTION),
        (calibration.drifts, StateReason.CALIBRATION_DRIFT),
        (ground.doubt is not None, StateReason.MOVING_REGIONS),
    )


def first_of(*doubts: tuple[bool, StateReason]) -> StateReason | None:
    """Return the reason of the first doubt that there is, None where there is none."""
    return next((reason for there, reason in doubts if there), None)


def are_finite(*arrays: FloatArray) -> bool:
    """Tell whether all numbers are finite."""
    return all(bool(np.isfinite(values).all()) for values in arrays)
