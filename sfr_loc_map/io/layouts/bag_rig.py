"""The cameras of a task in a bag: the topics of their images, and the rig that bag and configuration describe."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError, naming
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.extrinsics import RigInBody
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.poses import read_extrinsics
from sfr_loc_map.io.calibration.calibration_file import read_calibration
from sfr_loc_map.io.calibration.camera_info import RectifiedCamera
from sfr_loc_map.io.calibration.rectification import RectifiableCamera, StereoRectifier, rectifiable_cameras
from sfr_loc_map.io.calibration.stereo_calibration import StereoCalibration
from sfr_loc_map.io.images.codec import Samples, samples_of
from sfr_loc_map.io.source_config import CalibrationConfig, SourceConfig
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, IMAGE
from sfr_loc_map.suite_names import SIDES, Task
from sfr_loc_map.topics import RAW, RECTIFIED

_log = logging.getLogger(__name__)

HALVED_AXIS = {"side_by_side": 1, "top_bottom": 0}  #: Axis along which a joint image is halved, by its layout.


def image_name(bag: Bag, rig: str) -> str | None:
    """Return the last part of the names of a rig's image topics, if possible of rectified images; None if absent."""
    for name in (RECTIFIED, RAW):
        if any(bag.find(f"{rig}/{side}/{name}", IMAGE, COMPRESSED) for side in SIDES):
            return name
    return None


def require_topic(bag: Bag, name: str, *msgtypes: str) -> Topic:
    """Return the topic of a relative name; InputError if the bag does not have it."""
    topic = bag.find(name, *msgtypes)
    if topic is None:
        raise InputError(
            f"bag '{bag.path}' has no topic '{name}': it has {', '.join(sorted(bag.topics))}; record it, or name it "
            f"with --remap old:=new"
        )
    return topic


@dataclass(frozen=True, slots=True)
class BagImages:
    """The images of the cameras of a task in a bag."""

    bag: Bag
    task: Task
    layout: str  #: Layout of joint images, a key of `HALVED_AXIS`; empty for one topic per camera.
    topics: tuple[Topic, ...]  #: Left and right; a single topic of joint images.
    are_rectified: bool

    @classmethod
    def of(cls, bag: Bag, task: Task, layout: str) -> BagImages:
        """Return the images of a task; InputError if a topic is missing."""
        name = image_name(bag, task.rig)
        sides = SIDES[:1] if layout else SIDES
        topics = tuple(require_topic(bag, f"{task.rig}/{side}/{name}", IMAGE, COMPRESSED) for side in sides)
        return cls(bag, task, layout, topics, name == RECTIFIED)

    def decoded(self, topic: Topic, message: Any) -> Samples:  # noqa: ANN401 - types of rosbags
        """Return the image in a message; errors name bag and topic."""
        with naming(f"bag '{self.bag.path}', '{topic.bag_name}'"):
            return samples_of(message)

    def left_and_right(self, images: Sequence[GreyImage]) -> tuple[GreyImage, GreyImage]:
        """Return the left and right image of the images of all topics; a joint image is halved."""
        if not self.layout:
            return images[0], images[1]
        (image,) = images
        axis = HALVED_AXIS[self.layout]
        if image.shape[axis] % 2:
            raise InputError(
                f"bag '{self.bag.path}': joint images ({self.layout}) of {image.shape[1]} x {image.shape[0]} "
                "px cannot be divided into equal halves: correct the layout or the images"
            )
        left, right = np.split(image, 2, axis)
        return np.ascontiguousarray(left), np.ascontiguousarray(right)

    def first_message(self) -> Any:  # noqa: ANN401 - types of rosbags
        """Return the first message of the left, or joint, images."""
        topic = self.topics[0]
        first = self.bag.first([topic])
        if not first:
            raise InputError(f"bag '{self.bag.path}' has no message on '{topic.bag_name}'")
        return first[topic.name]


@dataclass(frozen=True, slots=True, eq=False)
class BagRig:
    """The rig of a task, as the configuration and the bag describe it."""

    rig: StereoRig  #: Rig of the rectified images; for the drive with its pose on the rover, if known.
    rectifier: StereoRectifier | None  #: None if the images are rectified.
    frame: str  #: Frame of the left camera.
    calibrated_by: str  #: Origin of the calibration.
    mount: RigInBody | None  #: Pose of the rig on the rover, if it is from the bag.


def rig_of_bag(images: BagImages, calibration: CalibrationConfig, config: SourceConfig) -> BagRig:
    """Return the rig of a task; `calibration` applies to this task."""
    found, frame = _by_file(images, Path(calibration.file)) if calibration.file else _by_camera_info(images)
    with naming(images.bag.path):
        if calibration.baseline_m:
            found = found.with_baseline(calibration.baseline_m)
        rig, rectifier = found.rig(images.task.rig)
    mount = None
    if images.task is Task.LOCALISATION:
        T_rb_sb = config.extrinsics.transform() or found.T_rb_sb
        if T_rb_sb is None:
            mount = read_extrinsics(images.bag, frame, rig.baseline_m, config.frames.base)
            if mount is None and config.frames.base:
                _log.warning(
                    f"bag '{images.bag.path}': frames.base is '{config.frames.base}', but /tf_static does not connect "
                    f"this frame to '{frame}', the frame of the left camera: the extrinsics are unknown"
                )
            T_rb_sb = None if mount is None else mount.T_rb_sb
        rig = replace(rig, T_rb_sb=T_rb_sb)
    return BagRig(rig, rectifier, frame, found.text, mount)


def _by_file(images: BagImages, file: Path) -> tuple[StereoCalibration, str]:
    """Return the calibration in a file, and the frame of the left images."""
    message = images.first_message()
    first = images.decoded(images.topics[0], message).grey()
    if images.layout:
        first, _ = images.left_and_right([first])
    height, width = first.shape
    found = read_calibration(file, (width, height))
    if not images.layout:
        left_name, right_name = (topic.bag_name for topic in images.topics)
        sides = " and ".join(f"{images.task.rig}/{side}" for side in SIDES)
        with naming(images.bag.path):
            found.check_images(left_name, right_name, f"Exchange the topics of {sides} in 'topics' of sfr.yaml")
    return found, str(message.header.frame_id)


def camera_info_topics(images: BagImages) -> list[Topic]:
    """Return the topics of the calibrations of both cameras; InputError if a topic is missing."""
    return [require_topic(images.bag, f"{images.task.rig}/{side}/camera_info", CAMERA_INFO) for side in SIDES]


def _by_camera_info(images: BagImages) -> tuple[StereoCalibration, str]:
    """Return the calibration in the first camera_info of both cameras, and the frame of the left camera."""
    bag, rig = images.bag, images.task.rig
    topics = camera_info_topics(images)
    infos = bag.first(topics)
    for topic in topics:
        if topic.name not in infos:
            raise InputError(
                f"bag '{bag.path}' has no message on '{topic.bag_name}': the rig is unknown; record this topic"
            )
    left, right = (infos[topic.name] for topic in topics)
    if images.are_rectified:
        with naming(bag.path):
            one, other = (
                RectifiedCamera.of(topic.name, info) for topic, info in zip(topics, (left, right), strict=True)
            )
        cameras = RectifiableCamera.of_rectified(one.size, one.p), RectifiableCamera.of_rectified(other.size, other.p)
    else:
        with naming(bag.path):
            cameras = rectifiable_cameras((left, right), rig)
    return StereoCalibration(cameras, images.are_rectified, None, "camera_info"), str(left.header.frame_id)


def check_one_calibration(images: BagImages, topic: Topic, messages: Iterable[bytes]) -> None:
    """Raise InputError if the messages of a camera_info topic contain several calibrations of the images.

    Differences that change no pixel (`RectifiableCamera.is_same`) are those of rounding.
    """
    first: RectifiableCamera | None = None
    for raw in sorted(messages):
        info = images.bag.deserialise(topic, raw)
        if images.are_rectified:
            with naming(images.bag.path):
                rectified = RectifiedCamera.of(topic.name, info)
            camera = RectifiableCamera.of_rectified(rectified.size, rectified.p)
        else:
            with naming(images.bag.path):
                camera = RectifiableCamera.of(topic.name, info)
        first = first or camera
        if not camera.is_same(first):
            raise InputError(
                f"bag '{images.bag.path}', '{topic.bag_name}': the calibration changes within the bag: divide the bag "
                "at the change, or give a constant calibration by --calibration FILE"
            )
