"""Checks of a stereo rig by its camera_info and a few images."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io.bag_sequence import RAW
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import image_from_compressed_message, image_from_message, stamp_of
from sfr_loc_map.io.rectification import StereoRectifier, rectified_rig
from sfr_loc_map.pipeline.doctor.finding import Cause, Finding, blocking
from sfr_loc_map.pipeline.doctor.observation import Observation, ObservedTopic

CORNERS = 80
PATCH_PX = 6
"""Half the side of a patch that is searched for."""
MIN_NCC = 0.85
"""Normalised cross-correlation of a patch that is matched."""
MIN_MATCHES = 10
"""Matches on the wrong side that a decision needs."""
SWAPPED_RATIO = 4.0
"""Swapped: more than so many matches on the wrong side for each on the right one."""
StampedImages = list[tuple[int, GreyImage]]


def check_stereo(seen: Observation, task: str) -> Iterator[Finding]:
    """Yield issues of camera_info and images of a rig whose images are there."""
    rig: StereoRig | None = None
    rectifier: StereoRectifier | None = None
    try:
        rig, rectifier = _rig(seen, task)
    except InputError as error:
        text, _, fix = str(error).partition(": ")
        yield blocking(Cause.CAMERA_INFO, f"{task}/left/camera_info, {task}/right/camera_info", text, fix)
    images: dict[str, StampedImages] = {}
    for side in SIDES:
        topic = seen.images(task, side)
        if topic is None:
            return
        try:
            images[side] = [(stamp_of(message), _grey(message)) for message in topic.messages]
        except InputError as error:
            yield _encoding(topic, error)
            return
        height, width = images[side][0][1].shape
        if rig is not None and (width, height) != (rig.width, rig.height):
            text = f"its images are {width} x {height}, camera_info says {rig.width} x {rig.height}"
            yield blocking(Cause.IMAGE_SIZE, topic.found, text, "publish the camera_info of these images")
            return
    if rectifier is not None:
        images = _rectified(images, rectifier)
    if left_right_swapped(images["left"], images["right"]):
        text = "objects lie further right in the right images: left and right are swapped"
        yield blocking(Cause.SWAPPED, f"{task}/left/{seen.image_name(task)}", text, "swap the topics (cables, remaps)")


def left_right_swapped(lefts: StampedImages, rights: StampedImages) -> bool:
    """Tell by patches of the left images whether they lie further right in the right ones of the nearest stamp.

    A point in front of parallel cameras lies at u_left - u_right = f baseline / Z > 0.
    """
    if lefts[0][1].shape != rights[0][1].shape:
        return False
    shifts = np.zeros(0)
    for stamp_ns, left in lefts:
        _, right = min(rights, key=lambda item: abs(item[0] - stamp_ns))
        shifts = np.concatenate((shifts, _shifts(left, right)))
    wrong, correct = int(np.sum(shifts < -0.5)), int(np.sum(shifts > 0.5))
    return wrong >= MIN_MATCHES and wrong > SWAPPED_RATIO * correct


def _rig(seen: Observation, task: str) -> tuple[StereoRig | None, StereoRectifier | None]:
    """Return the rig of the first camera_info of both sides, None where one is absent, and what rectifies raw images.

    Raises:
        InputError: If they are not those of a rectified rig, or of raw cameras that can be rectified.
    """
    infos = [topic for side in SIDES if (topic := seen.topics.get(f"{task}/{side}/camera_info")) and topic.messages]
    if len(infos) < len(SIDES):
        return None, None
    messages = [topic.messages[0] for topic in infos]
    if seen.image_name(task) == RAW:
        return rectified_rig(messages, task)
    return rig_from_camera_info(messages[0], messages[1], task), None


def _rectified(images: Mapping[str, StampedImages], rectifier: StereoRectifier) -> dict[str, StampedImages]:
    """Return rectified images; sides with more images than the other are cut."""
    pairs = list(zip(*(images[side] for side in SIDES), strict=False))
    rectified = [rectifier.rectify(left, right) for (_, left), (_, right) in pairs]
    return {
        side: [(pair[at][0], both[at]) for pair, both in zip(pairs, rectified, strict=True)]
        for at, side in enumerate(SIDES)
    }


def _encoding(topic: ObservedTopic, error: InputError) -> Finding:
    return blocking(
        Cause.ENCODING, topic.found, str(error), "publish mono8, mono16, rgb8, bgr8, a Bayer mosaic or yuv422"
    )


def _grey(message: Any) -> GreyImage:  # noqa: ANN401 - Image or CompressedImage of any library
    return image_from_message(message) if hasattr(message, "encoding") else image_from_compressed_message(message)


def _shifts(left: GreyImage, right: GreyImage) -> FloatArray:
    """Return u_left - u_right of distinct patches of the left image that are matched in their row of the right one."""
    corners = cv2.goodFeaturesToTrack(left, CORNERS, 0.02, 2.0 * PATCH_PX)
    found = []
    for u, v in np.rint(np.empty((0, 2)) if corners is None else corners[:, 0]).astype(int):
        patch = left[max(v - PATCH_PX, 0) : v + PATCH_PX + 1, max(u - PATCH_PX, 0) : u + PATCH_PX + 1]
        rows = right[max(v - PATCH_PX, 0) : v + PATCH_PX + 1]
        scores = cv2.matchTemplate(rows, patch, cv2.TM_CCOEFF_NORMED)[0]
        best = int(np.argmax(scores))
        if scores[best] > MIN_NCC:
            found.append(float(max(u - PATCH_PX, 0) - best))
    return np.array(found)
