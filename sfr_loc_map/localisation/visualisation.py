"""Visualisation of a tracked pair: its landmarks, their optical flow and residuals."""

from __future__ import annotations

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import ColourImage, FloatArray, GreyImage
from sfr_loc_map.localisation.estimate import LandmarkTracks, PoseEstimate, TrackingState

SMALL_RESIDUAL = np.array([255.0, 170.0, 60.0])  #: Colour of an inlier without residual: blue, green, red.
LARGE_RESIDUAL = np.array([0.0, 225.0, 255.0])  #: Colour of an inlier at the gate: blue, green, red.
OUTLIER = (220, 60, 220)  #: Colour of an outlier: blue, green, red.
NOT_FOUND = (150, 150, 150)  #: Colour of a landmark that was not found: blue, green, red.
STATES = {
    TrackingState.INITIALISING: (0, 190, 255),
    TrackingState.TRACKING: (120, 220, 120),
    TrackingState.DEGRADED: (0, 215, 255),
    TrackingState.LOST: (60, 60, 255),
}
FIGURES = {"inliers": "in", "features": "of", "keyframes": "kf", "chi_median": "chi", "residual_px": "px"}
"""Statistics in the caption, if the estimate has them, and their short names."""
STRIP = 18  #: Height of the caption below the image, px.
_SHIFT = 4  # OpenCV draws in units of 1/16 pixel


def draw_tracks(left: GreyImage, estimate: PoseEstimate) -> ColourImage:
    """Return the left image with the tracked landmarks of its estimate.

    A line connects the observation in the newest keyframe with the observation in this image. The colour of the line
    ranges from blue (no residual) to yellow (largest residual of an inlier), and is violet for an outlier. A grey cross
    is a landmark that was not found, at its observation in the keyframe. The frame and the caption show the state and
    the statistics of the call.

    The drawing is `(H + 18, W, 3)` uint8, blue, green, red.
    """
    height, width = left.shape
    canvas = np.zeros((height + STRIP, width, 3), np.uint8)
    # a darker image makes the colours stand out
    canvas[:height] = cv2.cvtColor(left, cv2.COLOR_GRAY2BGR) // 4 * 3
    if estimate.tracks is not None:
        draw_landmarks(canvas[:height], estimate.tracks)
    colour = STATES[estimate.state]
    cv2.rectangle(canvas, (0, 0), (width - 1, height - 1), colour, 2)
    statistics = estimate.statistics.as_dict()
    figures = [f"{word} {statistics[name]:.3g}" for name, word in FIGURES.items() if name in statistics]
    state = " ".join(filter(None, (estimate.state.value, estimate.reason_text)))
    caption = "  ".join([f"{estimate.stamp_ns / 1e9:.3f} s", state, *figures])
    cv2.putText(canvas, caption, (4, height + 13), cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, 1, cv2.LINE_AA)
    return canvas


def draw_landmarks(canvas: ColourImage, tracks: LandmarkTracks) -> None:
    """Draw the lines, dots and crosses of `draw_tracks` on an image."""
    # blue to yellow is distinguishable with any colour vision
    weight = np.clip(np.nan_to_num(tracks.residual, nan=1.0), 0.0, 1.0)[:, None]
    colours = np.rint((1.0 - weight) * SMALL_RESIDUAL + weight * LARGE_RESIDUAL)
    for start, end, residual, colour in zip(tracks.keyframe_uv, tracks.uv, tracks.residual, colours, strict=True):
        if not np.isfinite(residual) or not np.isfinite(end).all():
            if np.isfinite(start).all():
                centre = (round(float(start[0])), round(float(start[1])))
                cv2.drawMarker(canvas, centre, NOT_FOUND, cv2.MARKER_TILTED_CROSS, 4)
            continue
        bgr = OUTLIER if residual >= 1.0 else tuple(map(int, colour))
        if np.isfinite(start).all():
            cv2.line(canvas, _fixed(start), _fixed(end), bgr, 1, cv2.LINE_AA, _SHIFT)
        cv2.circle(canvas, _fixed(end), 2 << _SHIFT, bgr, -1, cv2.LINE_AA, _SHIFT)


def _fixed(uv: FloatArray) -> tuple[int, int]:
    return round(float(uv[0]) * (1 << _SHIFT)), round(float(uv[1]) * (1 << _SHIFT))
