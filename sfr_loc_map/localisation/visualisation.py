"""A picture that shows why a pair was easy or hard: its landmarks, how well they agree, and where they came from."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import ColourImage, FloatArray, GreyImage
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.localisation.frontend.tracking import Tracked

CHI_LIMIT = 9.0
"""Squared Mahalanobis residual a degree of freedom at which the colours end: beyond it a landmark is an outlier."""
AGREES, HARDLY = np.array([255.0, 170.0, 60.0]), np.array([0.0, 225.0, 255.0])
OUTLIER = (220, 60, 220)
NOT_FOUND = (150, 150, 150)
STATES = {
    TrackingState.INITIALISING: (0, 190, 255),
    TrackingState.TRACKING: (120, 220, 120),
    TrackingState.LOST: (60, 60, 255),
}
FIGURES = {"inliers": "in", "features": "of", "keyframes": "kf", "chi_median": "chi", "residual_px": "px"}
"""Statistics that are written below the picture, as far as the estimate has them, and their short names."""
STRIP = 18
"""Height of the strip of text below the picture, pixels."""
_SHIFT = 4  # OpenCV draws at fractions of 1/16 pixel


def draw_tracks(left: GreyImage, tracked: Tracked | None, estimate: PoseEstimate) -> ColourImage:
    """Return the left picture with what the localiser found in it.

    A line goes from where the newest keyframe saw a landmark to where it is seen now; its colour goes from blue (agrees
    with the pose) to yellow (hardly does), violet is an outlier, a grey cross a landmark that was not found and stands
    where the keyframe saw it. The frame and the strip below show the state and the figures of the call.

    Args:
        left: `(H, W)` uint8.
        tracked: What was found of the landmarks, None where none was looked for.
        estimate: What the localiser said of the pair.

    Returns:
        `(H + 18, W, 3)` uint8, blue, green, red.
    """
    height, width = left.shape
    canvas = np.zeros((height + STRIP, width, 3), np.uint8)
    # a dimmer picture lets the colours stand out
    canvas[:height] = cv2.cvtColor(left, cv2.COLOR_GRAY2BGR) // 4 * 3
    if tracked is not None:
        _draw_landmarks(canvas[:height], tracked)
    colour = STATES[estimate.state]
    cv2.rectangle(canvas, (0, 0), (width - 1, height - 1), colour, 2)
    cv2.putText(canvas, _caption(estimate), (4, height + 13), cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, 1, cv2.LINE_AA)
    return canvas


def _draw_landmarks(canvas: ColourImage, tracked: Tracked) -> None:
    before, now = tracked.landmarks.last_seen[:, :2], tracked.observed[:, :2]
    colours = _colours(tracked.chi)
    for start, end, chi, colour in zip(before, now, tracked.chi, colours, strict=True):
        if not np.isfinite(chi) or not np.isfinite(end).all():
            if np.isfinite(start).all():
                place = (round(float(start[0])), round(float(start[1])))
                cv2.drawMarker(canvas, place, NOT_FOUND, cv2.MARKER_TILTED_CROSS, 4)
            continue
        bgr = OUTLIER if chi >= CHI_LIMIT else tuple(map(int, colour))
        if np.isfinite(start).all():
            cv2.line(canvas, _fixed(start), _fixed(end), bgr, 1, cv2.LINE_AA, _SHIFT)
        cv2.circle(canvas, _fixed(end), 2 << _SHIFT, bgr, -1, cv2.LINE_AA, _SHIFT)


def _colours(chi: FloatArray) -> NDArray[np.uint8]:
    """Return the colours `(M, 3)` of residuals: blue to yellow, told apart with any colour vision."""
    share = np.sqrt(np.clip(np.nan_to_num(chi, nan=CHI_LIMIT) / CHI_LIMIT, 0.0, 1.0))[:, None]
    return np.asarray(np.rint((1.0 - share) * AGREES + share * HARDLY), np.uint8)


def _fixed(place: FloatArray) -> tuple[int, int]:
    return round(float(place[0]) * (1 << _SHIFT)), round(float(place[1]) * (1 << _SHIFT))


def _caption(estimate: PoseEstimate) -> str:
    figures = [
        f"{word} {estimate.statistics[name]:.3g}" for name, word in FIGURES.items() if name in estimate.statistics
    ]
    return "  ".join([f"{estimate.stamp_ns / 1e9:.3f} s", estimate.state.value, *figures])
