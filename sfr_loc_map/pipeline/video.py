"""Images of the tracks as a film."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2

from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.visualisation import STRIP, draw_tracks
from sfr_loc_map.pipeline.offline import FrameObserver

CODECS = {".avi": "MJPG", ".mp4": "mp4v"}
"""Coding by the ending of the file's name; both are part of OpenCV's wheels."""
FRAMES_PER_SECOND = 10.0


@contextmanager
def track_video(path: Path, rig: StereoRig) -> Iterator[FrameObserver]:
    """Give a watch of the localiser that appends an image of the tracks of each pair to a film.

    The film takes its name when the block ends well.

    Args:
        path: File that ends in .avi (Motion JPEG) or .mp4 (MPEG-4).
        rig: Rig of the drive.

    Raises:
        OutputError: If the ending is another one, or the file cannot be written.
    """
    if path.suffix not in CODECS:
        raise OutputError(f"'{path}' is not the name of a video: give one that ends in {' or '.join(CODECS)}")
    with atomic_path(path) as temporary:
        code = cv2.VideoWriter.fourcc(*CODECS[path.suffix])
        writer = cv2.VideoWriter(str(temporary), code, FRAMES_PER_SECOND, (rig.width, rig.height + STRIP))
        if not writer.isOpened():
            raise OutputError(f"cannot write '{path}': this OpenCV has no coder {CODECS[path.suffix]}")

        frames = 0

        def watch(pair: StereoPair, estimate: PoseEstimate, localiser: Localiser) -> None:
            nonlocal frames
            writer.write(draw_tracks(pair.left, localiser.last_result, estimate))
            frames += 1

        try:
            yield watch
        finally:
            writer.release()
        found = _frames_in(temporary) if frames else 0
        if found < frames:  # the coder does not say when the disk is full
            raise OutputError(
                f"cannot write '{path}': the film has {found} of {frames} images; check the space and the rights"
            )


def _frames_in(path: Path) -> int:
    """Return the number of images of a film, 0 where it cannot be opened."""
    reader = cv2.VideoCapture(str(path))
    try:
        return int(reader.get(cv2.CAP_PROP_FRAME_COUNT)) if reader.isOpened() else 0
    finally:
        reader.release()
