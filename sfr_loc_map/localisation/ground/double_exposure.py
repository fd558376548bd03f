"""Double exposures: estimate the weight of a second exposure, taken at another pose, in a tracked image.

Frame grabbers and compressed streams may blend an image with the previous image. Each patch then shows the sum of two
exposures, taken at two poses. Both exposures are predicted from the texture T of the patch in its host keyframe. The
homography H of each pose maps the host image to the tracked image. At a pixel x of the tracked image, the model is

    image(x) = a T(H_shown^-1 x) + b T(H_other^-1 x) + constant + noise

The factors a and b are estimated by linear least squares, together with a shift of the tracked exposure, whose pose has
a small error. The weight of the other exposure is b / (|a| + |b|). In an image of a single exposure, the weight is zero
up to noise, whatever the brightness and contrast.

Blended exposures are known from injected faults only. In one drive with ghosts of 69 % in bursts, an error of a step
was 110 times its 3 sigma without this test, and 0.71 times with this test (measurements/localiser_injected_faults.md).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, median
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.patch import COARSE_SAMPLED_PX, sample
from sfr_loc_map.localisation.small_linalg import fill_inverse_4

MIXTURE_LEVEL: Final = 1
"""Pyramid level of the comparison. Keyframes keep this level, which has half the noise of the image."""
MIXTURE_HALF: Final = 3
"""Half width of a patch, px of the level. 49 px of the level determine four factors and cover 14 x 14 px of the image.
Larger patches contain edges of stones more often. Smaller patches give noisier factors."""
MIXTURE_SIDE: Final = 2 * MIXTURE_HALF + 1  #: Side of a patch, pixels of the level.
MIN_EXPOSURE_CONTRAST: Final = 2.0
"""Minimum standard deviation of each exposure and of the image in a patch, grey levels. The value is above the noise of
the level (half that of the image). A larger value leaves fewer patches. A smaller value adds noise to the weights."""
MIN_SEPARATION: Final = 0.2
"""Minimum fraction of the variance of the other exposure that the tracked exposure and its shift leave unexplained. At
0.2 the variance of the factor b is five times that of a single exposure (variance inflation). The fraction is below 0.2
if the projections of the patch from the two poses are less than about two pixels of the level apart."""
SHOWN, SHIFT_X, SHIFT_Y, OTHER, IMAGE = range(5)
"""Columns of the least-squares problem: tracked exposure, its derivatives along x and y, other exposure, image."""
MIN_FACTORS: Final = 1e-6  #: Minimum of |a| + |b|. The weight is finite even if the image resembles neither exposure.
RIDGE: Final = 1e-6  #: Relative and absolute increase of a normal matrix's diagonal, for a positive definite matrix.
DEVIATION_RATIO: Final = 1.858
"""Ratio of the standard error of the median, times the square root of the sample size, to the median absolute deviation
of a normal sample: 1.4826 (Rousseeuw and Croux 1993) times the square root of pi / 2."""
MIXTURE_PATCHES: Final = 32
"""Minimum number of patches for the detection of a second exposure, or `min_tracked` if that is smaller. The value is
half of the patches that are compared (`evidence.MIXTURE_LANDMARKS`). If larger, ghosts in images with little contrast
are missed. If smaller, the standard error of the weight is estimated from too few patches."""
MIN_MIXTURE_WEIGHT: Final = 0.1
"""An image shows a second exposure if the lower bound of the estimated weight of this exposure exceeds this value. In
images of one exposure the estimate differs from 0 by a few hundredths at most."""
MIXTURE_SIGMAS: Final = 3.0
"""Number of standard errors between the weight and its lower bound, so that the bound is too high in one image in
740 (normal errors). If larger, weak ghosts are missed."""


class Mixture(NamedTuple):
    """Weight of another exposure in an image."""

    weight: float  #: Median of the weights in the patches; NaN without patches.
    standard_error: float  #: Standard error of that median; NaN without patches.
    patches: int  #: Number of patches in which the two exposures can be separated.


class _Hosted(NamedTuple):
    """Patches of one host image."""

    image: FloatImage  #: Level `MIXTURE_LEVEL` of the host image.
    uv: FloatArray  #: `(N, 2)` centres of the patches, pixels of full size.
    to_shown: FloatArray  #: `(N, 3, 3)` homographies from the host to the image at the tracked pose.
    to_other: FloatArray  #: `(N, 3, 3)` homographies from the host to the image at the other pose.


class _Workspace(NamedTuple):
    """Arrays that are filled for each patch."""

    inverse: FloatArray  #: `(3, 3)` homography from the image at the tracked pose to the host.
    shown: FloatArray  #: `(S + 2, S + 2)` tracked exposure with a border for its derivatives; S is the side of a patch.
    columns: FloatArray  #: `(5, S * S)` columns `SHOWN` to `IMAGE`.


class _MappedPixel(NamedTuple):
    """A pixel of full size."""

    u: float
    v: float


@jit_fast_inline
def _mapped(h: FloatArray, u: float, v: float) -> _MappedPixel:
    """Return the pixel to which a homography maps a pixel; NaN at infinity."""
    w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
    if w == 0.0:
        return _MappedPixel(np.nan, np.nan)
    return _MappedPixel((h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w, (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w)


@jit_fast_inline
def _fill_inverse(h: FloatArray, inverse: FloatArray) -> None:
    """Fill the inverse of a homography, up to its scale (the adjugate)."""
    for i in range(3):
        for j in range(3):
            below, beside = (j + 1) % 3, (i + 1) % 3
            second, third = (j + 2) % 3, (i + 2) % 3
            inverse[i, j] = h[below, beside] * h[second, third] - h[below, third] * h[second, beside]


@jit_fast_inline
def _level_sample(image: FloatImage, at: _MappedPixel) -> np.float32:
    """Return a level of an image at a pixel of full size; NaN outside."""
    height, width = image.shape
    x = (at.u + 0.5) / (1 << MIXTURE_LEVEL) - 0.5
    y = (at.v + 0.5) / (1 << MIXTURE_LEVEL) - 0.5
    if not (0.0 <= x < width - COARSE_SAMPLED_PX and 0.0 <= y < height - COARSE_SAMPLED_PX):
        return np.float32(np.nan)
    return sample(image, x, y)


@jit_fast_inline
def _fill_columns(image: FloatImage, hosted: _Hosted, n: int, work: _Workspace) -> None:
    """Fill the columns of the least-squares problem for the pixels of a patch; NaN outside either image."""
    shown = work.shown
    columns = work.columns
    from_shown = work.inverse
    host_image = hosted.image
    host_u = hosted.uv[n, 0]
    host_v = hosted.uv[n, 1]
    to_other = hosted.to_other[n]
    _fill_inverse(hosted.to_shown[n], from_shown)
    for j in range(MIXTURE_SIDE + 2):
        for i in range(MIXTURE_SIDE + 2):
            u = host_u + (i - MIXTURE_HALF - 1) * (1 << MIXTURE_LEVEL)
            v = host_v + (j - MIXTURE_HALF - 1) * (1 << MIXTURE_LEVEL)
            at = _mapped(to_other, u, v)
            shown[j, i] = _level_sample(host_image, _mapped(from_shown, at.u, at.v))
            if 1 <= i <= MIXTURE_SIDE and 1 <= j <= MIXTURE_SIDE:
                k = (j - 1) * MIXTURE_SIDE + i - 1
                columns[OTHER, k] = _level_sample(host_image, _MappedPixel(u, v))
                columns[IMAGE, k] = _level_sample(image, at)
    for j in range(MIXTURE_SIDE):
        for i in range(MIXTURE_SIDE):
            k = j * MIXTURE_SIDE + i
            columns[SHOWN, k] = shown[j + 1, i + 1]
            columns[SHIFT_X, k] = 0.5 * (shown[j + 1, i + 2] - shown[j + 1, i])
            columns[SHIFT_Y, k] = 0.5 * (shown[j + 2, i + 1] - shown[j, i + 1])


@jit_fast_inline
def _subtract_means(columns: FloatArray) -> None:
    """Subtract the mean of each column in place, which eliminates the constant of the model."""
    for c in range(IMAGE + 1):
        mean = 0.0
        for k in range(MIXTURE_SIDE * MIXTURE_SIDE):
            mean += columns[c, k]
        mean /= MIXTURE_SIDE * MIXTURE_SIDE
        for k in range(MIXTURE_SIDE * MIXTURE_SIDE):
            columns[c, k] -= mean


@jit_fast_inline
def _fill_products(columns: FloatArray, products: FloatArray, with_image: FloatArray) -> None:
    """Fill the products of the columns: the normal equations of the least-squares problem.

    `products` `(4, 4)` holds the products of the model's columns with each other (upper half only). `with_image` `(5,)`
    holds the products of all columns with the image.
    """
    for c in range(IMAGE + 1):
        for d in range(c, IMAGE + 1):
            total = 0.0
            for k in range(MIXTURE_SIDE * MIXTURE_SIDE):
                total += columns[c, k] * columns[d, k]
            if d == IMAGE:
                with_image[c] = total
            else:
                products[c, d] = total


@jit_fast_inline
def _weight(products: FloatArray, with_image: FloatArray, inverse: FloatArray) -> float:
    """Solve the normal equations of a patch for the factors, and return the weight of the other exposure.

        factors = products^-1 with_image
        weight = b / (|a| + |b|)

    NaN if a patch is not inside both images, has too little contrast, or does not separate the exposures. `inverse`
    `(4, 4)` is filled.
    """
    least_power = MIXTURE_SIDE * MIXTURE_SIDE * MIN_EXPOSURE_CONTRAST**2
    power = min(products[SHOWN, SHOWN], products[OTHER, OTHER])
    # False for NaN: a patch must be inside both images
    if not (power > least_power and with_image[IMAGE] > least_power and np.isfinite(with_image[SHOWN])):
        return np.nan
    for c in range(IMAGE):
        products[c, c] = products[c, c] * (1.0 + RIDGE) + RIDGE
    fill_inverse_4(products, inverse)
    if inverse[OTHER, OTHER] * products[OTHER, OTHER] * MIN_SEPARATION > 1.0:
        return np.nan
    a = 0.0
    b = 0.0
    for c in range(IMAGE):
        a += inverse[SHOWN, c] * with_image[c]
        b += inverse[OTHER, c] * with_image[c]
    return b / max(abs(a) + abs(b), MIN_FACTORS)


@jit_fast
def _weights(image: FloatImage, hosted: _Hosted) -> FloatArray:
    """Return the weight of the other exposure in each patch `(N,)`; NaN if the weight cannot be estimated."""
    count = len(hosted.uv)
    weights = np.empty(count)
    work = _Workspace(
        np.empty((3, 3)),
        np.empty((MIXTURE_SIDE + 2, MIXTURE_SIDE + 2)),
        np.empty((IMAGE + 1, MIXTURE_SIDE * MIXTURE_SIDE)),
    )
    products = np.empty((IMAGE, IMAGE))
    with_image = np.empty(IMAGE + 1)
    inverse = np.empty((IMAGE, IMAGE))
    for n in range(count):
        _fill_columns(image, hosted, n, work)
        _subtract_means(work.columns)
        _fill_products(work.columns, products, with_image)
        weights[n] = _weight(products, with_image, inverse)
    return weights


def mixture_of(image: FloatImage, landmarks: Landmarks, to_shown: FloatArray, to_other: FloatArray) -> Mixture:
    """Return the weight of another exposure in an image.

    Args:
        image: Level `MIXTURE_LEVEL` of a left image.
        landmarks: The N landmarks that were tracked in the image.
        to_shown: `(N, 3, 3)` homographies (`plane_homographies`) to the image at which the landmarks were tracked.
        to_other: `(N, 3, 3)` homographies to the image at the pose of the other exposure.
    """
    uv = landmarks.planes.uv
    found = []
    for host_image, rows in landmarks.patches.hosts(MIXTURE_LEVEL):
        found.append(_weights(image, _Hosted(host_image, uv[rows], to_shown[rows], to_other[rows])))
    weights = np.concatenate(found) if found else np.zeros(0)
    weights = weights[np.isfinite(weights)]
    if not len(weights):
        return Mixture(np.nan, np.nan, 0)
    weight = median(weights)
    deviation = DEVIATION_RATIO * median(np.abs(weights - weight))
    return Mixture(weight, standard_error=float(deviation / np.sqrt(len(weights))), patches=len(weights))


def shows_second_exposure(
    image: FloatImage, landmarks: Landmarks, to_shown: FloatArray, to_other: FloatArray, min_tracked: int
) -> bool:
    """Return whether an image also shows landmarks from another pose than that at which they were tracked.

    A second exposure requires `MIXTURE_PATCHES` patches, or `min_tracked` if smaller. The other arguments are those of
    `mixture_of`.
    """
    mixture = mixture_of(image, landmarks, to_shown, to_other)
    lower_bound = mixture.weight - MIXTURE_SIGMAS * mixture.standard_error
    has_enough_patches = mixture.patches >= min(min_tracked, MIXTURE_PATCHES)
    return has_enough_patches and lower_bound > MIN_MIXTURE_WEIGHT
