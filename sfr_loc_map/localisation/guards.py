"""Guards: checks of a pair and of its pose.

Each guard is a function `check_*` that returns findings and changes nothing. Two guards make a further measurement, but
only if the earlier evidence leaves the order of the images open (`check_order`, `check_sides`). `findings.RULES` lists
the consequences of all findings. Findings about the ground's motion come from `ground.selection`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from sfr_loc_map.geometry.arrays import is_finite
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.findings import Finding
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.right_camera import RightCameraOffset
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame, is_textured
from sfr_loc_map.localisation.frontend.tracking import Tracker, Tracks
from sfr_loc_map.localisation.motion_model import LastPose
from sfr_loc_map.localisation.motion_size import MotionSize, size_between
from sfr_loc_map.localisation.small_linalg import is_positive_definite
from sfr_loc_map.localisation.stale_images import ImageComparison, show_one_image

SLACK: Final = MotionSize(1.0, 1.0)
"""Motion, m and rad, that is always accepted, because stamps may jitter. At the default maximum speed and turn rate,
these values correspond to errors of the stamps of 20 ms and 170 ms. If larger, wrong poses near the last pose are
accepted."""

MIN_STEREO_FRACTION: Final = 0.3
"""Ratio `Tracks.stereo_fraction` up to which a pair is one-sided. Landmarks are triangulated from both
images, so that both images of a good pair show most landmarks."""
ORDER_TESTED_RATIO: Final = 0.1
"""Ratio of the landmarks of a new window to the cells in which corners are detected, up to which the order of the
images is tested. Swapped images have landmarks by chance only. In two drives, and in copies of these drives with a
twentieth of the contrast, the ratio is at most 0.05 for swapped images, and at least 0.37 for correct images."""
SWAPPED_FACTOR: Final = 4
"""Images are swapped if an exchange of the images multiplies the number of landmarks of a new window by at least this
factor. In the same drives, the factor is at least 7 for swapped images."""
MAX_SHEAR: Final = 7.0
"""Maximum ratio of the squared shear of the rows to its variance, per degree of freedom, for rows exposed at one time.
The ratio is at most 6.4 on clean drives and 7 to 250 for a shear of 1 px, so some shears of 1 px are not
reported."""
MAX_MEAN_SHEAR: Final = 1.4
"""Maximum mean of this ratio for rows exposed at one time. The mean is at most 1.3 on clean drives and 2 to 5 for a
shear of 0.3 px."""
FIRST_SHEAR_GAIN: Final = 0.2
"""Initial gain g of the running mean. Each pair changes the gain to g / (1 + g), so that the initial mean has the
weight of five pairs."""
MIN_SHEAR_GAIN: Final = 0.05  #: Minimum gain of the running mean, which then covers about 20 pairs.


# ---- images


def check_images(pair: StereoPair, images: ImageComparison, *, has_map: bool) -> frozenset[Finding]:
    """Report images, or parts of images, that repeat the previous pair, and left and right copies of one image.

    Without a map, a repeated pair is not reported: its two images belong together, so that a window may begin with the
    pair.
    """
    return (
        _found(Finding.IDENTICAL_IMAGES, show_one_image(pair))
        | _found(Finding.REPEATED_PAIR, images.is_repeated and has_map)
        | _found(Finding.FROZEN_IMAGE, images.is_one_frozen)
        | _found(Finding.STALE_ROWS, images.has_stale_rows)
    )


# ---- the pose


def check_landmarks(frame: StereoFrame, landmarks: Landmarks, min_tracked: int) -> frozenset[Finding]:
    """Report a map with too few landmarks, and whether the images are the cause."""
    return frozenset() if len(landmarks.rows) >= min_tracked else _too_few(frame)


def check_order(
    count: int, count_if_swapped: Callable[[], int], min_tracked: int, max_corners: int
) -> frozenset[Finding]:
    """Report swapped images at the start of a window. The order is tested only if the window has few landmarks.

    Args:
        count: Number of landmarks that were triangulated from the images.
        count_if_swapped: Returns the number of landmarks that are triangulated after an exchange of left and right.
        min_tracked: Minimum number of landmarks of a window.
        max_corners: Number of cells in which corners are detected.
    """
    if count >= max(min_tracked, ORDER_TESTED_RATIO * max_corners):
        return frozenset()
    return _found(Finding.SWAPPED, count_if_swapped() >= max(min_tracked, SWAPPED_FACTOR * count))


def check_tracks(frame: StereoFrame, tracks: Tracks) -> frozenset[Finding]:
    """Report tracks that are not trusted, and whether the images are the cause.

    The criterion `Tracks.is_trusted` also decides whether to relocalise.
    """
    return frozenset() if tracks.is_trusted else _too_few(frame)


def _too_few(frame: StereoFrame) -> frozenset[Finding]:
    """Return the findings of too few landmarks, with the causes in the images."""
    return (
        frozenset({Finding.FEW_LANDMARKS})
        | _found(Finding.UNTEXTURED, not frame.was_received_textured())
        | _found(Finding.FROZEN_AND_FEW, frame.has_frozen_image)
    )


def check_pose(tracks: Tracks, last: LastPose, stamp_ns: int, bounds: MotionBounds) -> frozenset[Finding]:
    """Report a pose that is not determined, or that the rover cannot have reached since the last known pose.

    A determined pose is finite, and its information matrix is positive definite.
    """
    if not (is_finite(*tracks.pose) and is_positive_definite(tracks.information)):
        return frozenset({Finding.SINGULAR})
    seconds = last.unobserved_s(stamp_ns)
    moved = size_between(Pose.of(last.T_world_left), tracks.pose)
    max_m = SLACK.metres + bounds.max_speed_m_s * seconds
    max_rad = SLACK.radians + bounds.max_turn_rad_s * seconds
    return _found(Finding.TOO_FAST, not moved.is_within(MotionSize(max_m, max_rad)))


def check_sides(frame: StereoFrame, tracks: Tracks, tracker: Tracker, offset: RightCameraOffset) -> frozenset[Finding]:
    """Report that few inliers of one image are observed in the other image.

    There are three causes: the other image has no texture, the images are swapped (which the tracker tests), or one
    image is stale.
    """
    if tracks.stereo_fraction > MIN_STEREO_FRACTION:
        return frozenset()
    if not is_textured(frame.right if tracks.is_left_fuller else frame.left):
        return frozenset({Finding.UNTEXTURED_SIDE})
    is_swapped = tracker.fits_swapped(frame, tracks, offset)
    return frozenset({Finding.ONE_SIDED}) | _found(Finding.SWAPPED, is_swapped)


def check_gap(gap_keyframes: int) -> frozenset[Finding]:
    """Report a window that began after an unobserved motion, until the window is full.

    The argument is `State.gap_keyframes`.
    """
    return _found(Finding.AFTER_GAP, gap_keyframes > 0)


def check_adjustment(*, has_diverged: bool) -> frozenset[Finding]:
    """Report a window that begins because an adjustment diverged. The argument is `State.has_diverged`."""
    return _found(Finding.DIVERGED, has_diverged)


# ---- the right camera


def check_calibration(calibration: OnlineCalibration) -> frozenset[Finding]:
    """Report a right camera that drifts, or whose yaw is not yet corrected."""
    return _found(Finding.CALIBRATION, not calibration.is_settled)


class ShearMean(NamedTuple):
    """Running mean of the shear statistic, the memory of `check_shear`."""

    value: float = 1.0
    gain: float = FIRST_SHEAR_GAIN

    def with_pair(self, shear_chi2: float) -> ShearMean:
        """Return the mean with the statistic of a further pair."""
        gain = max(self.gain / (1.0 + self.gain), MIN_SHEAR_GAIN)
        return ShearMean(self.value + gain * (shear_chi2 - self.value), gain)


def check_shear(shear_chi2: float, mean: ShearMean) -> frozenset[Finding]:
    """Report rows exposed at different times (rolling shutter), in this pair or on average including this pair."""
    return _found(Finding.SHEARED_ROWS, shear_chi2 > MAX_SHEAR or mean.value > MAX_MEAN_SHEAR)


def _found(finding: Finding, is_present: bool) -> frozenset[Finding]:
    """Return a finding if it is present."""
    return frozenset({finding} if is_present else ())
