"""Guards: checks of the images and of the pose, and the table that decides what follows from their findings.

`RULES` lists all findings in the order of precedence, with what follows from each. There are two kinds:

- A finding that refuses a pair ends its call at once (`Localiser._refuse`). These findings stand in the table in the
  order in which they are checked.
- Findings that degrade a pose are collected. The first one present gives the published reason (`decide`).

| findings | found by |
|---|---|
| `REPEATED_PAIR`, `FROZEN_IMAGE`, `STALE_ROWS` | `check_images` |
| `IDENTICAL_IMAGES`, `SWAPPED`, `ONE_SIDED` | `is_one_image`, `Tracker.fits_swapped`, `is_one_sided` |
| `UNTEXTURED`, `FEW_LANDMARKS` | `of_few_landmarks`, if `Tracks.is_trusted` is false |
| `SINGULAR`, `TOO_FAST` | `is_determined`, `motion_model.is_plausible` |
| `CONTRADICTED`, `PARTIAL_TRANSFER`, `UNEXPLAINED`, `UNSETTLED`, `AMBIGUOUS` | `ground_motion` |
| `CALIBRATION`, `SHEARED_ROWS` | `check_calibration`, `check_shear` |
| `AFTER_GAP` | `State.settled_from` |

A new guard adds a `Finding`, a row in `RULES`, and a call in `Localiser._locate` or `_judge`. If it needs a memory, the
memory is a field of `State`.

How stale images are detected:

- The noise of a camera makes two images of one scene differ in every textured row. Rows that are equal to the last bit
  were therefore not exposed again.
- A frozen image may have new noise. It then shows the same scene twice, as a stationary rover does. Two exposures have
  independent noise: where noise made the first image brighter, the second one is darker (regression to the mean, slope
  -1/2). A frozen image with added noise differs independently of the first (slope 0). If hardly a pixel differs, there
  was no exposure at all.
- A partially transferred image consists of two exposures: it is new above some row, and of the pair before below it, or
  the other way round.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from enum import Enum, auto
from typing import Final, NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.estimate import StateReason
from sfr_loc_map.localisation.frontend.tracking import MIN_TEXTURE, StereoFrame, Tracks, is_textured

# ---- what follows from a finding


class Action(Enum):
    """What happens to a pair."""

    KEEP = auto()  #: The last pose is published again, with a larger covariance. A lost localiser stays lost.
    REJECT = auto()  #: The localiser is lost. No window may begin with the pair.
    RESTART = auto()  #: The localiser is lost. After some good images a new window begins at the last pose.
    DEGRADE = auto()  #: The pose is accepted and the state is degraded.
    ACCEPT = auto()  #: The pose is accepted.

    @property
    def refuses(self) -> bool:
        """Whether the pose of the pair is not accepted."""
        return self in (Action.KEEP, Action.REJECT, Action.RESTART)


class Finding(Enum):
    """What a guard may find in a pair."""

    REPEATED_PAIR = auto()  #: Both images are those of the pair before, also swapped or with new noise.
    IDENTICAL_IMAGES = auto()  #: Left and right image are the same image.
    UNTEXTURED = auto()  #: Too few landmarks were tracked, and an image has no texture.
    FEW_LANDMARKS = auto()  #: Too few landmarks were tracked, or they do not agree on a pose.
    CONTRADICTED = auto()  #: The pose predicts no motion where the image changed.
    SINGULAR = auto()  #: The pose is not finite or not determined.
    SWAPPED = auto()  #: Left and right image are swapped.
    TOO_FAST = auto()  #: No rover moves that fast.
    FROZEN_IMAGE = auto()  #: One image is that of the pair before.
    STALE_ROWS = auto()  #: Some rows are those of the pair before.
    AFTER_GAP = auto()  #: The window began after a motion that no image showed.
    CALIBRATION = auto()  #: The right camera drifts, or a yaw is still to be corrected.
    SHEARED_ROWS = auto()  #: The rows of the images are of different moments.
    PARTIAL_TRANSFER = auto()  #: Parts of the images are of different moments.
    UNEXPLAINED = auto()  #: An unusual fraction of the landmarks does not follow the pose.
    UNSETTLED = auto()  #: An earlier pair was contradicted, ambiguous, stale or partially transferred.
    ONE_SIDED = auto()  #: Few inliers are seen in both images although both have texture: one of them may be old.
    AMBIGUOUS = auto()  #: It is unknown which of two motions is the ground's.


class Rule(NamedTuple):
    """What follows from a finding."""

    action: Action
    reason: StateReason
    #: Whether the covariance allows for the motion since the last pose, because the images may partly be older. If the
    #: stale parts are known, they are blanked, and the pose is that of the new parts.
    adds_unobserved: bool = False
    #: Whether later pairs may be compared with this one: as a keyframe, for relocalisation, to detect changes.
    may_be_keyframe: bool = True


RULES: Final = {
    Finding.REPEATED_PAIR: Rule(Action.KEEP, StateReason.REPEATED_IMAGES),
    Finding.IDENTICAL_IMAGES: Rule(Action.REJECT, StateReason.NO_STEREO),
    Finding.UNTEXTURED: Rule(Action.RESTART, StateReason.UNTEXTURED_IMAGES),
    Finding.FEW_LANDMARKS: Rule(Action.RESTART, StateReason.FEW_LANDMARKS),
    Finding.CONTRADICTED: Rule(Action.KEEP, StateReason.MOVING_REGIONS),
    Finding.SINGULAR: Rule(Action.RESTART, StateReason.IMPLAUSIBLE_MOTION),
    Finding.SWAPPED: Rule(Action.REJECT, StateReason.NO_STEREO),
    Finding.TOO_FAST: Rule(Action.RESTART, StateReason.IMPLAUSIBLE_MOTION),
    Finding.FROZEN_IMAGE: Rule(Action.DEGRADE, StateReason.REPEATED_IMAGES, may_be_keyframe=False),
    Finding.STALE_ROWS: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, may_be_keyframe=False),
    Finding.AFTER_GAP: Rule(Action.DEGRADE, StateReason.UNSEEN_MOTION),
    Finding.CALIBRATION: Rule(Action.DEGRADE, StateReason.CALIBRATION_DRIFT),
    Finding.SHEARED_ROWS: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, adds_unobserved=True),
    Finding.PARTIAL_TRANSFER: Rule(
        Action.DEGRADE, StateReason.TORN_IMAGES, adds_unobserved=True, may_be_keyframe=False
    ),
    Finding.UNEXPLAINED: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, adds_unobserved=True),
    Finding.UNSETTLED: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, adds_unobserved=True),
    Finding.ONE_SIDED: Rule(Action.DEGRADE, StateReason.TORN_IMAGES, adds_unobserved=True),
    Finding.AMBIGUOUS: Rule(Action.DEGRADE, StateReason.MOVING_REGIONS),
}
"""What follows from each finding, in the order of precedence.

The covariance is larger after a few findings only. `AMBIGUOUS` adds `Ground.ambiguity`, which is at least the motion
since the last pose. `CALIBRATION` adds nothing by itself: the yaw and its standard deviation are always in the
covariance. `AFTER_GAP` adds nothing by itself: the motion that no image showed is in the start of the window.
"""


class Verdict(NamedTuple):
    """What happens to a pair, and why."""

    action: Action
    reason: StateReason | None  #: Reason of the finding that decides; None without findings.
    adds_unobserved: bool  #: Whether the covariance allows for the motion since the last pose.
    may_be_keyframe: bool  #: Whether later pairs may be compared with this one.


def decide(findings: Collection[Finding]) -> Verdict:
    """Return what follows from the findings of a pair whose pose is not refused."""
    rules = [rule for finding, rule in RULES.items() if finding in findings]
    return Verdict(
        action=rules[0].action if rules else Action.ACCEPT,
        reason=rules[0].reason if rules else None,
        adds_unobserved=any(rule.adds_unobserved for rule in rules),
        may_be_keyframe=all(rule.may_be_keyframe for rule in rules),
    )


# ---- stale images

ROW_STEPS: Final = (16, 1)  #: Row steps of the comparison: all rows are compared if every 16th does not decide.
MAX_NOISE: Final = 12.0  #: Standard deviation of a difference, grey levels, above which the scene moved.
NOISE_MARGIN: Final = 1.1  #: Factor on the variance in the first test, because images are rounded.
MAX_NEIGHBOUR_CORRELATION: Final = 0.2  #: Correlation of neighbouring differences above which the scene moved.
UNDEREXPOSED: Final = 8  #: Grey level up to which noise is clipped.
OVEREXPOSED: Final = 247  #: Grey level from which noise is clipped.
MIN_PIXELS: Final = 256  #: Minimum number of exposed pixels for a decision.
MIDDLE_SLOPE: Final = -0.25  #: Slope between that of two exposures (-1/2) and that of a frozen image (0).
STANDARD_ERRORS: Final = 4.0  #: Standard errors of the slope for a decision.
CALM_QUANTILE: Final = 0.1  #: Quantile of the neighbouring texture from which a pixel is weighted down.
MAX_CHANGED: Final = 0.1
"""Fraction of the exposed pixels that differ in an image that was not exposed again. A noise of a tenth of a grey level
makes a tenth of the pixels of two exposures differ."""
MIN_ROW_RANGE: Final = 8  #: Range of grey levels of a textured row: sky and saturated rows are equal in all images.
MIN_STALE_FRACTION: Final = 0.05  #: Fraction of stale rows from which an image is partially transferred.
PROBE: Final = 64  #: Column and row step of a first comparison.


class StaleRows(NamedTuple):
    """Rows of one image that repeat the image before."""

    rows: Mask  #: `(H,)` textured rows that are equal; all rows if the image is repeated with new noise.
    is_frozen: bool  #: Whether all textured rows are repeated, and there are some.
    is_same: bool  #: Whether the whole image is repeated, textured or not, perhaps with new noise.


class ImageMemory(NamedTuple):
    """What the next pair is compared with."""

    pair: StereoPair  #: The last pair; a frozen image is replaced by the one that was exposed.
    left: StaleRows  #: Stale rows of the last pair.
    right: StaleRows


class ImageCheck(NamedTuple):
    """A pair with its stale parts blanked."""

    pair: StereoPair
    findings: frozenset[Finding]
    stale_rows: Mask  #: `(H,)` rows that were blanked in either image.
    memory: ImageMemory | None


def check_images(pair: StereoPair, memory: ImageMemory | None) -> ImageCheck:
    """Compare a pair with the one before, and blank what was not exposed again.

    A part that stays the same for several pairs is not stale but fixed to the camera, and is not blanked.
    """
    nothing = np.zeros(len(pair.left), np.bool_)
    if memory is None:
        fresh = StaleRows(nothing, is_frozen=False, is_same=False)
        return ImageCheck(pair, frozenset(), nothing, ImageMemory(pair, fresh, fresh))
    before = memory.pair
    left = stale_rows(before.left, pair.left)
    right = stale_rows(before.right, pair.right)
    if is_swapped_repeat(before, pair):
        exposed = StereoPair(pair.stamp_ns, before.right, before.left)
        return ImageCheck(pair, frozenset({Finding.REPEATED_PAIR}), nothing, ImageMemory(exposed, left, right))
    findings = set()
    if left.is_same and right.is_same:
        findings.add(Finding.REPEATED_PAIR)
    # a frozen image is always compared with the one that was exposed
    exposed_left = before.left if left.is_frozen else pair.left
    exposed_right = before.right if right.is_frozen else pair.right
    after = ImageMemory(StereoPair(pair.stamp_ns, exposed_left, exposed_right), left, right)
    blank_left = left.rows if left.is_frozen else left.rows & ~memory.left.rows
    blank_right = right.rows if right.is_frozen else right.rows & ~memory.right.rows
    blank = blank_left | blank_right
    if not blank.any():
        return ImageCheck(pair, frozenset(findings), nothing, after)
    findings.add(Finding.FROZEN_IMAGE if left.is_frozen or right.is_frozen else Finding.STALE_ROWS)
    blanked = replace(pair, left=_blanked(pair.left, blank_left), right=_blanked(pair.right, blank_right))
    return ImageCheck(blanked, frozenset(findings), blank, after)


def stale_rows(before: GreyImage, now: GreyImage) -> StaleRows:
    """Return the rows of an image that repeat the image before."""
    # most images move and differ by more than noise: this test is cheap
    change = cv2.subtract(now[1 : -1 : ROW_STEPS[0]], before[1 : -1 : ROW_STEPS[0]], dtype=cv2.CV_32F)
    is_small = cv2.meanStdDev(change)[1].item() ** 2 <= NOISE_MARGIN * MAX_NOISE**2
    if is_small and is_repeated_with_noise(before, now):
        return StaleRows(np.ones(len(now), np.bool_), is_frozen=True, is_same=True)
    same = (before[:, ::PROBE] == now[:, ::PROBE]).all(axis=1)
    if same.any():
        same &= (before == now).all(axis=1)
        textured = np.ptp(now, axis=1) >= MIN_ROW_RANGE
        rows = same & textured
        if np.count_nonzero(rows) >= MIN_STALE_FRACTION * len(now):
            return StaleRows(rows, is_frozen=bool(same[textured].all()), is_same=bool(same.all()))
    return StaleRows(np.zeros(len(now), np.bool_), is_frozen=False, is_same=bool(same.all()))


def is_swapped_repeat(before: StereoPair, now: StereoPair) -> bool:
    """Return whether a pair is the one before with left and right swapped, perhaps with new noise."""
    few = slice(len(now.left) // 2, None, PROBE)  # few rows decide in most cases
    change = cv2.subtract(now.left[few], before.right[few], dtype=cv2.CV_32F)
    if cv2.meanStdDev(change)[1].item() ** 2 > NOISE_MARGIN * MAX_NOISE**2:
        return False
    return stale_rows(before.right, now.left).is_same and stale_rows(before.left, now.right).is_same


def _blanked(image: GreyImage, rows: Mask) -> GreyImage:
    if not rows.any():
        return image
    blanked = image.copy()
    blanked[rows] = 0
    return blanked


def is_repeated_with_noise(before: GreyImage, now: GreyImage) -> bool:
    """Return whether an image is an earlier one with new noise. Equal images have no new noise and give False."""
    for step in ROW_STEPS:
        change = np.asarray(cv2.subtract(now[1:-1:step], before[1:-1:step], dtype=cv2.CV_32F), np.float32)
        # noise is small, and independent from pixel to pixel
        centred = change - change.mean()
        variance = float(np.mean(np.square(centred)))
        covariance = float(np.mean(centred[:, 1:] * centred[:, :-1]))
        if variance > MAX_NOISE**2 or not covariance <= MAX_NEIGHBOUR_CORRELATION * variance:
            return False
        first = before[1:-1:step].astype(np.float32)
        exposed = (first[:, 1:-1] > UNDEREXPOSED) & (first[:, 1:-1] < OVEREXPOSED)
        if np.count_nonzero(exposed) < MIN_PIXELS:
            return False
        # the texture of the rows above and below gives the weight: their noise is independent of this row's
        above = np.abs(_second_difference(before[:-2:step].astype(np.float32)))
        below = np.abs(_second_difference(before[2::step].astype(np.float32)))
        texture = np.maximum(above, below)[exposed]
        scale = float(np.quantile(texture, CALM_QUANTILE)) + 1.0
        weight = np.asarray(1.0 / (np.square(texture) + scale**2), np.float32)
        # weighted slope of the changes over the first image, relative to their power, and its standard error
        there = _second_difference(first)[exposed]
        changes = _second_difference(change)[exposed]
        power = float(np.sum(weight * np.square(changes)))
        if power > 0.0:
            products = weight * there * changes
            slope = float(np.sum(products)) / power
            standard_error = float(np.sqrt(np.sum(np.square(products)))) / power
            if abs(slope - MIDDLE_SLOPE) > STANDARD_ERRORS * standard_error:
                return slope > MIDDLE_SLOPE
    return float(np.mean(change[:, 1:-1][exposed] != 0.0)) < MAX_CHANGED and not np.array_equal(before, now)


def _second_difference(image: FloatImage) -> FloatImage:
    """Return the second difference along the rows, which holds noise and little of the scene."""
    return np.asarray(2.0 * image[:, 1:-1] - image[:, :-2] - image[:, 2:], np.float32)


# ---- wiring of the cameras

MIN_STEREO_FRACTION: Final = 0.3  #: Fraction of inliers seen in both images up to which a pair is one-sided.


def is_one_image(pair: StereoPair) -> bool:
    """Return whether left and right image are the same textured image."""
    few = slice(len(pair.left) // 2, None, PROBE)  # few rows decide in most cases
    if not np.array_equal(pair.left[few], pair.right[few]):
        return False
    return np.array_equal(pair.left, pair.right) and float(np.std(pair.left)) > MIN_TEXTURE


def is_one_sided(frame: StereoFrame, tracks: Tracks) -> bool:
    """Return whether few inliers of one image are seen in the other one, although that has texture.

    The images are then swapped, or one of them is old.
    """
    other = frame.right if tracks.is_left_fuller else frame.left
    return tracks.stereo_fraction <= MIN_STEREO_FRACTION and is_textured(other)


# ---- the pose


def of_few_landmarks(frame: StereoFrame) -> Finding:
    """Return why few landmarks were tracked."""
    return Finding.FEW_LANDMARKS if frame.is_textured else Finding.UNTEXTURED


def is_determined(tracks: Tracks) -> bool:
    """Return whether a pose is finite and its information matrix positive definite."""
    if not (np.isfinite(tracks.information).all() and np.isfinite(np.column_stack(tracks.pose)).all()):
        return False
    return bool(np.linalg.eigvalsh(tracks.information)[0] > 0.0)


def check_calibration(calibration: OnlineCalibration) -> frozenset[Finding]:
    """Return the finding that the right camera moves against its calibration."""
    return frozenset() if calibration.is_settled else frozenset({Finding.CALIBRATION})


# ---- shear of the rows (rolling shutter, partially transferred images)

MAX_SHEAR: Final = 7.0
"""Squared shear of the rows over its variance, per degree of freedom, above which rows are of different moments. It is
at most 6.4 on clean drives, and 7 or more for a shear of one pixel."""
MAX_MEAN_SHEAR: Final = 1.4
"""Mean of the same above which they are. It is at most 1.3 on clean drives, and 2 to 5 for a shear of 0.3 px."""
FIRST_SHEAR_GAIN: Final = 0.2  #: Gain g of the running mean before the first pair; each pair makes it g / (1 + g).
MIN_SHEAR_GAIN: Final = 0.05  #: Minimum gain of the running mean.


class ShearMean(NamedTuple):
    """Running mean of the shear statistic."""

    mean: float = 1.0
    gain: float = FIRST_SHEAR_GAIN

    def with_pair(self, shear: float) -> ShearMean:
        """Return the mean with the statistic of a further pair."""
        gain = max(self.gain / (1.0 + self.gain), MIN_SHEAR_GAIN)
        return ShearMean(self.mean + gain * (shear - self.mean), gain)


def check_shear(shear: float, after: ShearMean) -> frozenset[Finding]:
    """Return the finding that the rows of a pair are of different moments; the mean includes the pair."""
    is_sheared = shear > MAX_SHEAR or after.mean > MAX_MEAN_SHEAR
    return frozenset({Finding.SHEARED_ROWS}) if is_sheared else frozenset()
