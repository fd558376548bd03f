"""What can be seen of a stereo bench in its camera_info and a few pictures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.constants import SIDES
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import GreyImage, IntArray
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import image_from_compressed_message, image_from_message, stamp_of
from sfr_loc_map.pipeline.doctor.observation import Finding, Observation

CORNERS = 80
PATCH_PX = 6
"""Half the side of a patch that is looked for."""
GOOD_MATCH = 0.85
"""Normalised correlation of a patch that was found again."""
ENOUGH = 10
"""Patches found again that a judgement takes."""
EXCHANGED = 4.0
"""As many patches lie on the wrong side for each on the right one, if the pictures are exchanged."""


def nearest_ns(first: IntArray, second: IntArray) -> IntArray:
    """Return how far the nearest of the second stamps is from each of the first, nanoseconds."""
    second = np.sort(second)
    at = np.searchsorted(second, first)
    below, above = second[np.maximum(at - 1, 0)], second[np.minimum(at, len(second) - 1)]
    return np.asarray(np.minimum(np.abs(first - below), np.abs(above - first)), np.int64)


def examine_stereo(seen: Observation, task: str) -> Iterator[Finding]:
    """Yield what is wrong with camera_info and pictures of a bench whose pictures are there."""
    size = None
    infos = [topic for side in SIDES if (topic := seen.topics.get(f"{task}/{side}/camera_info")) and topic.messages]
    if len(infos) == 2:
        try:
            rig = rig_from_camera_info(infos[0].messages[0], infos[1].messages[0], task)
            size = (rig.width, rig.height)
        except InputError as error:
            text, _, cure = str(error).partition(": ")
            yield Finding("camera_info", True, f"{task}/left/camera_info, {task}/right/camera_info", text, cure)
    pictures: dict[str, list[tuple[int, GreyImage]]] = {}
    for side in SIDES:
        topic = seen.picture(task, side)
        if topic is None:
            return
        try:
            pictures[side] = [(stamp_of(message), _grey(message)) for message in topic.messages]
        except InputError as error:
            encoding = getattr(topic.messages[0], "encoding", "")
            bayer = encoding.startswith("bayer")
            text = f"its encoding {encoding} is a Bayer mosaic" if bayer else str(error)
            cure = (
                "rectify colour or grey (image_proc) and publish that"
                if bayer
                else "publish mono8, mono16, rgb8 or bgr8"
            )
            yield Finding("encoding", True, topic.found, text, cure)
            return
        height, width = pictures[side][0][1].shape
        if size is not None and (width, height) != size:
            text = f"its pictures are {width} x {height}, camera_info says {size[0]} x {size[1]}"
            yield Finding("picture_size", True, topic.found, text, "publish the camera_info of these pictures")
            return
    if pictures["left"][0][1].shape == pictures["right"][0][1].shape and _exchanged(
        pictures["left"], pictures["right"]
    ):
        text = "what is seen lies further right in the right pictures: left and right are exchanged"
        yield Finding("exchanged", True, f"{task}/left/image_rect", text, "exchange the topics (cables, remaps)")


def _grey(message: Any) -> GreyImage:  # noqa: ANN401 - Image or CompressedImage of any library
    return image_from_message(message) if hasattr(message, "encoding") else image_from_compressed_message(message)


def _exchanged(lefts: list[tuple[int, GreyImage]], rights: list[tuple[int, GreyImage]]) -> bool:
    """Tell by patches of the left pictures whether they lie further right in the right ones of the nearest stamp.

    A point in front of parallel cameras lies at u_left - u_right = f baseline / Z > 0.
    """
    shifts = np.zeros(0)
    for stamp_ns, left in lefts:
        _, right = min(rights, key=lambda item: abs(item[0] - stamp_ns))
        shifts = np.concatenate((shifts, _shifts(left, right)))
    wrong, correct = int(np.sum(shifts < -0.5)), int(np.sum(shifts > 0.5))
    return wrong >= ENOUGH and wrong > EXCHANGED * correct


def _shifts(left: GreyImage, right: GreyImage) -> NDArray[np.float64]:
    """Return u_left - u_right of distinct patches of the left picture that are found in their row of the right one."""
    corners = cv2.goodFeaturesToTrack(left, CORNERS, 0.02, 2.0 * PATCH_PX)
    found = []
    for u, v in np.rint(np.empty((0, 2)) if corners is None else corners[:, 0]).astype(int):
        patch = left[max(v - PATCH_PX, 0) : v + PATCH_PX + 1, max(u - PATCH_PX, 0) : u + PATCH_PX + 1]
        rows = right[max(v - PATCH_PX, 0) : v + PATCH_PX + 1]
        scores = cv2.matchTemplate(rows, patch, cv2.TM_CCOEFF_NORMED)[0]
        best = int(np.argmax(scores))
        if scores[best] > GOOD_MATCH:
            found.append(float(max(u - PATCH_PX, 0) - best))
    return np.array(found)
