"""Faults of images and of the right camera, as functions of the affected pair (`Affected`).

Functions that require OpenCV import it, so that `kinds.parse_fault` does not load it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

READ_NOISE = 1.0  #: Noise of a camera without light, grey levels.
DRIFT_PAIRS = 100.0  #: Number of pairs in which the right camera turns by the amount of a drift.


@dataclass(frozen=True, slots=True, eq=False)
class Affected:
    """An affected pair with the inputs of the function that changes its images."""

    pair: StereoPair  #: The pair with the faults that precede this fault in the order of the faults.
    #: The last earlier pair that is not a repetition, with the faults that precede this fault; None for the first pair.
    previous: StereoPair | None
    rig: StereoRig  #: The true rig.
    amount: float  #: Strength of the fault, in the unit of the kind.
    camera: str  #: Affected images: `both`, `left` or `right`.
    index: int  #: Index of the pair in the source.
    start: int  #: Index of the first pair that may be affected.
    progress: float  #: Fraction of the burst that has elapsed, 0 to 1. Meaningless for kinds without bursts.
    spot: FloatArray  #: `(2,)` random point, as fractions of width and height.
    pair_rng: np.random.Generator  #: Random generator of the pair.
    drive_rng: np.random.Generator  #: Random generator with the same seed for all pairs of a drive.

    def with_images(self, left: GreyImage, right: GreyImage) -> StereoPair:
        """Return the pair with new images of the affected cameras."""
        if self.camera == "right":
            left = self.pair.left
        elif self.camera == "left":
            right = self.pair.right
        return replace(self.pair, left=left, right=right)


Change = Callable[[Affected], StereoPair]
"""Returns the affected pair with the images of the fault; the stamp remains."""


# ---- operations on images


def as_grey(values: FloatArray | FloatImage) -> GreyImage:
    """Return rounded and clipped grey levels."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def with_noise(grey: FloatImage, sigma: float, rng: np.random.Generator) -> GreyImage:
    """Return grey levels `(H, W)` with Gaussian noise, rounded and clipped."""
    return as_grey(grey + sigma * rng.standard_normal(grey.shape, np.float32))


def moved(image: FloatImage, columns: float) -> FloatImage:
    """Return an image shifted to the right by a number of columns, which may be fractional; edges are mirrored."""
    return warped(image, np.array([[1.0, 0.0, columns], [0.0, 1.0, 0.0]]))


def warped(image: FloatImage, transform: FloatArray) -> FloatImage:
    """Return an image after an affine transform `(2, 3)`; edges are mirrored."""
    import cv2

    size = image.shape[::-1]
    moved_image = cv2.warpAffine(image, transform, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(moved_image, np.float32)


def smoothed(image: FloatImage, sigma_px: float) -> FloatImage:
    """Return an image after a Gaussian filter."""
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)


# ---- faults of the pair and of the right camera


def unchanged(at: Affected) -> StereoPair:
    """Return the pair unchanged."""
    return at.pair


def repeated(at: Affected) -> StereoPair:
    """Return the images of the last pair that is not a repetition, with the current stamp."""
    return at.pair if at.previous is None else replace(at.previous, stamp_ns=at.pair.stamp_ns)


def swapped(at: Affected) -> StereoPair:
    """Swap the left and the right image."""
    return replace(at.pair, left=at.pair.right, right=at.pair.left)


def identical(at: Affected) -> StereoPair:
    """Return the left image as both images."""
    return replace(at.pair, right=at.pair.left)


def shifted(at: Affected) -> StereoPair:
    """Shift the right image to the right."""
    return replace(at.pair, right=as_grey(moved(at.pair.right.astype(np.float32), at.amount)))


def rolled(at: Affected) -> StereoPair:
    """Rotate the right camera about its optical axis."""
    return _right_camera_rotated(at, 2, at.amount)


def pitched(at: Affected) -> StereoPair:
    """Pitch the right camera down."""
    return _right_camera_rotated(at, 0, -at.amount)


def yawed(at: Affected) -> StereoPair:
    """Turn the right camera to the left."""
    return _right_camera_rotated(at, 1, -at.amount)


def drifting(at: Affected) -> StereoPair:
    """Turn the right camera to the left at a constant rate, from the pair `start` of the fault on."""
    progress = max((at.index - at.start) / DRIFT_PAIRS, 0.0)
    return _right_camera_rotated(at, 1, -at.amount * progress)


def _right_camera_rotated(at: Affected, axis: int, angle_deg: float) -> StereoPair:
    return replace(at.pair, right=rotated(at.pair.right, axis, angle_deg, at.rig))


def rotated(image: GreyImage, axis: int, angle_deg: float, rig: StereoRig) -> GreyImage:
    """Return the image of a camera that is rotated relative to its calibration, by a homography `K R K^-1`.

    `axis` is the index of the rotation axis in the optical frame.
    """
    import cv2

    vector = np.zeros(3)
    vector[axis] = np.radians(angle_deg)
    K = rig.camera_matrix
    homography = K @ matrix_from_rotvec(vector).T @ np.linalg.inv(K)
    size = (rig.width, rig.height)
    return np.asarray(cv2.warpPerspective(image, homography, size, flags=cv2.INTER_CUBIC), np.uint8)


# ---- faults of single images


def each_image(change: Callable[[GreyImage, Affected], GreyImage]) -> Change:
    """Return the fault that changes each image of the affected cameras, the left image first."""

    @wraps(change)
    def changed(at: Affected) -> StereoPair:
        left = at.pair.left if at.camera == "right" else change(at.pair.left, at)
        right = at.pair.right if at.camera == "left" else change(at.pair.right, at)
        return replace(at.pair, left=left, right=right)

    return changed


@each_image
def black(image: GreyImage, at: Affected) -> GreyImage:
    """Return a black image."""
    return np.zeros_like(image)


@each_image
def blurred(image: GreyImage, at: Affected) -> GreyImage:
    """Blur with a Gaussian kernel."""
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), max(at.amount, 1e-3)), np.uint8)


@each_image
def sheared(image: GreyImage, at: Affected) -> GreyImage:
    """Shift each row in proportion to its distance from the middle row, in a random direction."""
    height = len(image)
    slope = (at.amount if at.spot[0] < 0.5 else -at.amount) / height
    shear = np.array([[1.0, slope, -0.5 * slope * height], [0.0, 1.0, 0.0]])
    return as_grey(warped(image.astype(np.float32), shear))


@each_image
def exposed(image: GreyImage, at: Affected) -> GreyImage:
    """Multiply the brightness by a factor."""
    return as_grey(at.amount * image.astype(np.float32))


@each_image
def noisy(image: GreyImage, at: Affected) -> GreyImage:
    """Add Gaussian noise."""
    return with_noise(image.astype(np.float32), at.amount, at.pair_rng)


@each_image
def faded(image: GreyImage, at: Affected) -> GreyImage:
    """Darken until the image is black in the middle of the burst, then brighten."""
    return with_noise(abs(2.0 * at.progress - 1.0) * image.astype(np.float32), READ_NOISE, at.pair_rng)


@each_image
def saturated(image: GreyImage, at: Affected) -> GreyImage:
    """Brighten until the fraction `amount` of the image is clipped."""
    white = max(float(np.quantile(image, 1.0 - at.amount)), 1.0)
    return with_noise(255.0 / white * image.astype(np.float32), READ_NOISE, at.pair_rng)


@each_image
def blinded(image: GreyImage, at: Affected) -> GreyImage:
    """Add a glare around a random point."""
    height, width = image.shape
    y, x = np.mgrid[:height, :width]
    distance_px = np.hypot(x - at.spot[0] * width, y - at.spot[1] * height)
    r = distance_px / max(0.5 * at.amount * width, 1e-6)
    glare = (255.0 * np.minimum(1.2, 1.2 / np.maximum(r, 1e-3) ** 3)).astype(np.float32)
    return as_grey(image.astype(np.float32) + glare)


# ---- faults that show the previous pair


def with_previous(change: Callable[[GreyImage, GreyImage, Affected], GreyImage]) -> Change:
    """Return the fault that combines each image with the image of the same camera in the last new pair.

    A new pair is a pair that is not a repetition. The first pair stays unchanged.
    """

    @wraps(change)
    def changed(at: Affected) -> StereoPair:
        if at.previous is None:
            return at.pair
        left = change(at.pair.left, at.previous.left, at)
        right = change(at.pair.right, at.previous.right, at)
        return at.with_images(left, right)

    return changed


@with_previous
def frozen(image: GreyImage, earlier: GreyImage, at: Affected) -> GreyImage:
    """Return the previous image with new noise."""
    return with_noise(earlier.astype(np.float32), at.amount, at.pair_rng)


@with_previous
def ghost(image: GreyImage, earlier: GreyImage, at: Affected) -> GreyImage:
    """Blend with the previous image."""
    return as_grey((1.0 - at.amount) * image + at.amount * earlier)


@with_previous
def torn(image: GreyImage, earlier: GreyImage, at: Affected) -> GreyImage:
    """Return the image with its lower rows replaced by the rows of the previous image."""
    rows = np.arange(len(image)) >= round((1.0 - at.amount) * len(image))
    return np.where(rows[:, None], earlier, image)


@with_previous
def interlaced(image: GreyImage, earlier: GreyImage, at: Affected) -> GreyImage:
    """Return the image with every second row of the previous image."""
    rows = np.arange(len(image)) % 2 == 1
    return np.where(rows[:, None], earlier, image)
