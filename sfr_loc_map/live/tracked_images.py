"""Images of both rigs for a screen. While tracks arrive, they are drawn on the left image of the localisation rig."""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import ColourImage, FloatArray32, GreyImage
from sfr_loc_map.latest import Latest
from sfr_loc_map.live.media import IMAGE_WIDTH, image_sample
from sfr_loc_map.live.updates import ImageSample
from sfr_loc_map.localisation.estimate import LandmarkTracks
from sfr_loc_map.localisation.visualisation import draw_landmarks
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.stamp_pairing import STAMP_TOLERANCE_S

LEFT, RIGHT = "loc/left", "loc/right"
HOLD_S = 2.0  #: Localisation images wait for their tracks if tracks arrived within this time, s.
MAX_WAITING = 24  #: Maximum number of waiting images: about 2 s of both cameras at the displayed rate.


class TrackedImages:
    """Passes images to `put`, immediately or with the tracks of their pair."""

    def __init__(self, put: Callable[[ImageSample], None]) -> None:
        self._put = put
        self._waiting = Latest[tuple[str, int], tuple[GreyImage, float]](MAX_WAITING)
        self._tracks_s = -HOLD_S  # arrival of the last tracks, monotonic clock

    def is_waiting(self, stamp_ns: int) -> bool:
        """Return whether a left image of this stamp waits for tracks."""
        return (LEFT, stamp_ns) in self._waiting

    def add_image(self, topic: str, stamp_ns: int, image: GreyImage, published_s: float) -> None:
        """Add an image."""
        if topic in (LEFT, RIGHT):
            self._waiting[topic, stamp_ns] = image, published_s
            if time.monotonic() - self._tracks_s < HOLD_S:
                return
        self._put(image_sample(topic, stamp_ns, image, published_s))

    def add_tracks(self, stamp_ns: int, tracks: FloatArray32) -> None:
        """Pass on the pair whose left image has this stamp.

        The left image is drawn with its tracks `(N, 5)`, which have the columns of the message.
        """
        self._tracks_s = time.monotonic()
        left = self._waiting.pop((LEFT, stamp_ns), None)
        right_ns = self._right_stamp(stamp_ns)
        if left is not None:
            image, published_s = left
            drawn = with_tracks(image, tracks)
            self._put(image_sample(LEFT, stamp_ns, drawn, published_s, image.shape, len(tracks)))
        if right_ns is not None:
            self._put(image_sample(RIGHT, right_ns, *self._waiting.pop((RIGHT, right_ns))))

    def _right_stamp(self, left_ns: int) -> int | None:
        """Return the stamp of the waiting right image that forms a pair with a left image; None if there is none."""
        stamps = [stamp_ns for topic, stamp_ns in self._waiting if topic == RIGHT]
        nearest = min(stamps, key=lambda stamp_ns: abs(stamp_ns - left_ns), default=None)
        return nearest if nearest is not None and are_of_pair(left_ns, nearest) else None


def are_of_pair(first_ns: int, second_ns: int) -> bool:
    """Return whether images of both sides with these stamps form a pair, by the default tolerance of the nodes."""
    return abs(first_ns - second_ns) <= STAMP_TOLERANCE_S * NS_PER_S


def with_tracks(image: GreyImage, tracks: FloatArray32) -> ColourImage:
    """Return an image, reduced for the screen, with feature tracks `(N, 5)` drawn on it.

    The columns are the pixel in this image, the pixel in the newest keyframe, and the residual divided by its gate.
    """
    height, width = image.shape
    scale = min(IMAGE_WIDTH / width, 1.0)
    size = (round(width * scale), max(round(height * scale), 1))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    canvas = np.asarray(cv2.cvtColor(small, cv2.COLOR_GRAY2BGR), np.uint8)
    uv = (tracks[:, 0:2].astype(np.float64) + 0.5) * scale - 0.5
    keyframe_uv = (tracks[:, 2:4].astype(np.float64) + 0.5) * scale - 0.5
    draw_landmarks(canvas, LandmarkTracks(uv, keyframe_uv, tracks[:, 4].astype(np.float64)))
    return canvas
