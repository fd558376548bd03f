"""Images that stay as they were but for new noise: a frozen camera, told from a rover that stands still.

Both show the same scene twice. A camera that is exposed again has noise of its own in either image: where noise made
the first one brighter, the second one is darker, as far as they differ at all (regression to the mean, slope -1/2). An
old image with noise added differs by what does not depend on it (slope 0). Where hardly a pixel differs, there was no
exposure at all.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage

ROW_STEPS: Final = (16, 1)
"""Every so many rows are compared; more of them where the first ones do not decide."""
MAX_NOISE: Final = 12.0
"""Standard deviation of a difference, grey levels, beyond which it is no noise: most moving images are told by it."""
MAX_NEIGHBOUR_CORRELATION: Final = 0.2
"""Correlation of neighbouring pixels of a difference beyond which it is no noise: what moves leaves edges."""
UNEXPOSED, OVEREXPOSED = 8, 247
"""Grey levels beyond which noise is cut off."""
MIN_PIXELS: Final = 256
"""Fewest exposed pixels that tell anything."""
MIDDLE_SLOPE: Final = -0.25
"""Slope of the difference over the first image, between that of two exposures and that of an old image."""
STANDARD_ERRORS: Final = 4.0
CALM_SHARE: Final = 0.1
"""Quantile of the texture beside a pixel from which on it counts less: noise is seen best where there is little."""
MAX_CHANGED: Final = 0.1
"""Share of the exposed pixels that differ in an image that was not exposed again; noise of a tenth of a grey level
makes a tenth of the pixels of two exposures differ."""


def is_frozen(before: GreyImage, now: GreyImage) -> bool:
    """Tell whether an image is one before it with new noise; equal images have none and are not told."""
    for step in ROW_STEPS:
        change = np.asarray(cv2.subtract(now[1:-1:step], before[1:-1:step], dtype=cv2.CV_32F), np.float32)
        if not _is_noise(change):
            return False
        first = before[1:-1:step].astype(np.float32)
        exposed = (first[:, 1:-1] > UNEXPOSED) & (first[:, 1:-1] < OVEREXPOSED)
        if np.count_nonzero(exposed) < MIN_PIXELS:
            return False
        # what is weighted by the texture of other rows has noise of any sign
        beside = (np.abs(_second_difference(rows.astype(np.float32))) for rows in (before[:-2:step], before[2::step]))
        weight = _calm(np.maximum(*beside)[exposed])
        slope, error = _regression(_second_difference(first)[exposed], _second_difference(change)[exposed], weight)
        if abs(slope - MIDDLE_SLOPE) > STANDARD_ERRORS * error:
            return slope > MIDDLE_SLOPE
    changed = float(np.mean(change[:, 1:-1][exposed] != 0.0))
    return changed < MAX_CHANGED and not np.array_equal(before, now)


def _calm(texture: FloatImage) -> FloatImage:
    """Return weights `(N,)` of pixels by the texture `(N,)` beside them."""
    scale = float(np.quantile(texture, CALM_SHARE)) + 1.0
    return np.asarray(1.0 / (np.square(texture) + scale**2), np.float32)


def _regression(image: FloatImage, change: FloatImage, weight: FloatImage) -> tuple[float, float]:
    """Return the weighted slope of changes `(N,)` over an image `(N,)`, in their power, and its standard error."""
    power = float(np.sum(weight * np.square(change)))
    if power == 0.0:
        return 0.0, np.inf
    products = weight * image * change
    return float(np.sum(products)) / power, float(np.sqrt(np.sum(np.square(products)))) / power


def _is_noise(change: FloatImage) -> bool:
    """Tell whether two images differ by noise alone, if at all: little, and each pixel for itself."""
    _, deviation = cv2.meanStdDev(change)  # the first look is rounded and cheap, and tells most
    if deviation.item() ** 2 > 1.1 * MAX_NOISE**2:
        return False
    centred = change - change.mean()
    variance = float(np.mean(np.square(centred)))
    if variance > MAX_NOISE**2:
        return False
    return float(np.mean(centred[:, 1:] * centred[:, :-1])) <= MAX_NEIGHBOUR_CORRELATION * variance


def _second_difference(image: FloatImage) -> FloatImage:
    """Return what varies from pixel to pixel along the rows: noise, and little of the scene."""
    return np.asarray(2.0 * image[:, 1:-1] - image[:, :-2] - image[:, 2:], np.float32)
