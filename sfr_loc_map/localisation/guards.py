"""Guards: checks of a pair and of its pose.

Each guard is one pure function `check_*`: it takes values and returns findings. What follows from findings is in one
table (`findings.RULES`). A guard that compares a pair with earlier ones takes what is remembered of them as an
argument: the comparison of the images (`stale_images.compare`), the running mean of the shear (`ShearMean`).
`check_sides` is given the tracker, because it tracks all landmarks once more in swapped images. The findings of the
ground's motion are those of `ground_cases.findings_of`.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.findings import Finding, Findings
from sfr_loc_map.localisation.frontend.right_camera import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, Tracks, is_textured
from sfr_loc_map.localisation.motion_model import LastPose
from sfr_loc_map.localisation.motion_size import MotionSize, size_between
from sfr_loc_map.localisation.stale_images import ImageComparison, are_equal

SLACK: Final = MotionSize(1.0, 1.0)
"""Motion, m and rad, that is plausible whatever the stamps are: stamps may jitter. Chosen by hand: at the default
maximum speed and turn rate it admits stamps that are wrong by 20 ms and 170 ms. If larger, a slow wrong pose is
accepted."""
MAX_ADJUSTMENT: Final = MotionSize(1.0, 1.0)
"""Motion of the newest pose by a bundle adjustment, m and rad, above which the adjustment diverged. Chosen by hand far
above the usual motion, which is millimetres, or some centimetres with a correction of the yaw."""

MIN_CONTRAST: Final = 1.0
"""Minimum standard deviation of a textured image in full resolution, grey levels: rounding to whole grey levels gives
at most 0.5."""
MIN_STEREO_FRACTION: Final = 0.3
"""Fraction of inliers seen in both images up to which a pair is one-sided. Landmarks are triangulated from both images,
so that both show most of them in a good pair."""
MAX_SHEAR: Final = 7.0
"""Squared shear of the rows over its variance, per degree of freedom, above which rows are of different moments. It is
at most 6.4 on clean drives, and 7 to 250 for a shear of one pixel: the smallest of these may not be reported."""
MAX_MEAN_SHEAR: Final = 1.4
"""Mean of the same above which they are. It is at most 1.3 on clean drives, and 2 to 5 for a shear of 0.3 px."""
FIRST_SHEAR_GAIN: Final = 0.2
"""Gain g of the running mean before the first pair; each pair changes it to g / (1 + g). The initial mean therefore has
the weight of five pairs."""
MIN_SHEAR_GAIN: Final = 0.05  #: Minimum gain of the running mean: it covers some twenty pairs.


# ---- images


def check_images(images: ImageComparison, *, has_map: bool) -> Findings:
    """Report images, or parts of them, that repeat the pair before.

    Without a map, a repeated pair is not reported: its images are of one moment, and a window may begin with it.
    """
    if images.is_repeated:
        return _found(Finding.REPEATED_PAIR, has_map)
    is_frozen = images.is_left_frozen or images.is_right_frozen
    is_torn = bool(images.stale_rows.any())
    return _found(Finding.FROZEN_IMAGE, is_frozen) | _found(Finding.STALE_ROWS, is_torn)


def check_wiring(pair: StereoPair) -> Findings:
    """Report a pair whose left and right image are the same textured image."""
    is_one_image = are_equal(pair.left, pair.right) and float(np.std(pair.left)) > MIN_CONTRAST
    return _found(Finding.IDENTICAL_IMAGES, is_one_image)


# ---- the pose


def check_landmarks(frame: StereoFrame, count: int, min_tracked: int) -> Findings:
    """Report a map with too few landmarks to be tracked, and whether the images are the cause."""
    return frozenset() if count >= min_tracked else _too_few(frame)


def check_tracks(frame: StereoFrame, tracks: Tracks) -> Findings:
    """Report tracks that are not trusted, and whether the images are the cause.

    The criterion is that of the tracker (`Tracks.is_trusted`), which decides by it whether to relocalise.
    """
    return frozenset() if tracks.is_trusted else _too_few(frame)


def _too_few(frame: StereoFrame) -> Findings:
    """Return the finding of too few landmarks."""
    return frozenset({Finding.FEW_LANDMARKS if frame.is_textured else Finding.UNTEXTURED})


def check_pose(tracks: Tracks, last: LastPose, stamp_ns: int, bounds: MotionBounds) -> Findings:
    """Report a pose that is not determined, or that no rover can have reached since the last known one.

    A determined pose is finite, and its information matrix is positive definite.
    """
    numbers = (tracks.information, tracks.pose.rotation, tracks.pose.position)
    is_finite = all(np.isfinite(array).all() for array in numbers)
    is_determined = is_finite and np.linalg.eigvalsh(tracks.information)[0] > 0.0
    if not is_determined:
        return frozenset({Finding.SINGULAR})
    seconds = last.unseen_s(stamp_ns)
    moved = size_between(Pose.of(last.T_world_left), tracks.pose)
    max_m = SLACK.metres + bounds.max_speed_m_s * seconds
    max_rad = SLACK.radians + bounds.max_turn_rad_s * seconds
    return _found(Finding.TOO_FAST, not moved.is_within(MotionSize(max_m, max_rad)))


def check_adjustment(last: LastPose, pose: Pose, covariance: FloatArray) -> Findings:
    """Report an adjustment that diverged: its pose is not finite, or far from the last known one.

    The covariance `(6, 6)` is that of the adjusted pose.
    """
    if not all(np.isfinite(array).all() for array in (*pose, covariance)):
        return frozenset({Finding.DIVERGED})
    moved = size_between(Pose.of(last.T_world_left), pose)
    return _found(Finding.DIVERGED, not moved.is_within(MAX_ADJUSTMENT))


def check_sides(frame: StereoFrame, tracks: Tracks, tracker: Tracker, offset: RightOffset) -> Findings:
    """Report that few inliers of one image are seen in the other one, although that has texture.

    The images are then swapped, which the tracker tests, or one of them is old.
    """
    if tracks.stereo_fraction > MIN_STEREO_FRACTION:
        return frozenset()
    if not is_textured(frame.right if tracks.is_left_fuller else frame.left):
        return frozenset()
    is_swapped = tracker.fits_swapped(frame, tracks, offset)
    return frozenset({Finding.SWAPPED if is_swapped else Finding.ONE_SIDED})


def check_gap(*, keyframes: int, clean_from_keyframe: int) -> Findings:
    """Report a window that began after a motion that no image showed, until it has enough keyframes."""
    return _found(Finding.AFTER_GAP, keyframes < clean_from_keyframe)


# ---- the right camera


def check_calibration(calibration: OnlineCalibration) -> Findings:
    """Report a right camera that moves against its calibration."""
    return _found(Finding.CALIBRATION, not calibration.is_settled)


class ShearMean(NamedTuple):
    """Running mean of the shear statistic: memory of `check_shear`."""

    value: float = 1.0
    gain: float = FIRST_SHEAR_GAIN

    def with_pair(self, shear_chi2: float) -> ShearMean:
        """Return the mean with the statistic of a further pair."""
        gain = max(self.gain / (1.0 + self.gain), MIN_SHEAR_GAIN)
        return ShearMean(self.value + gain * (shear_chi2 - self.value), gain)


def check_shear(shear_chi2: float, mean: ShearMean) -> Findings:
    """Report rows of different moments (rolling shutter), in the pair or on average; the mean includes the pair."""
    return _found(Finding.SHEARED_ROWS, shear_chi2 > MAX_SHEAR or mean.value > MAX_MEAN_SHEAR)


def _found(finding: Finding, is_present: bool) -> Findings:
    """Return a finding if it is present."""
    return frozenset({finding} if is_present else ())
