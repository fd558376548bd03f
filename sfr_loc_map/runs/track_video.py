"""The feature-track video of a drive."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.localisation.visualisation import STRIP, draw_tracks
from sfr_loc_map.suffixes import check_suffix, suffix_of

CODECS = {".avi": "MJPG", ".mp4": "mp4v"}
"""Codec by the ending of the file name; OpenCV's wheels contain both codecs."""
FRAMES_PER_SECOND = 10.0
FrameObserver = Callable[[StereoPair, PoseEstimate], None]
"""Function that receives a pair and its estimate with the tracks after each call. Its time is not measured."""


@contextmanager
def track_video(path: Path, rig: StereoRig) -> Iterator[FrameObserver]:
    """Provide an observer that appends an image of the tracks of each pair to a video, kept only on success."""
    check_suffix(path, CODECS)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # silent: errors are reported in one line
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    with atomic_path(path) as temporary:
        suffix = suffix_of(path)
        code = cv2.VideoWriter.fourcc(*CODECS[suffix])
        writer = cv2.VideoWriter(str(temporary), code, FRAMES_PER_SECOND, (rig.width, rig.height + STRIP))
        if not writer.isOpened():
            other = next(name for name in CODECS if name != suffix)
            raise OutputError(
                f"cannot write '{path}': this OpenCV has no encoder {CODECS[suffix]}; choose a name that ends in "
                f"{other}, or install the wheel opencv-python"
            )
        count = 0

        def add(pair: StereoPair, estimate: PoseEstimate) -> None:
            nonlocal count
            writer.write(draw_tracks(pair.left, estimate))
            count += 1

        try:
            yield add
        finally:
            writer.release()
        film = cv2.VideoCapture(str(temporary))  # the writer does not report a full disk
        if (found := round(film.get(cv2.CAP_PROP_FRAME_COUNT))) < count:
            raise OutputError(f"cannot write '{path}': {max(found, 0)} of {count} frames were kept; is the disk full?")
