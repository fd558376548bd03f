"""The cameras of a task in a bag: the topics of their images and calibrations, and their rectified rig."""

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
from sfr_loc_map.io.calibration.projections import with_baseline
from sfr_loc_map.io.calibration.rectification import RectifiableCamera, StereoRectifier, rig_of_infos
from sfr_loc_map.io.image_codec import Samples, samples_of
from sfr_loc_map.io.source_config import CalibrationConfig
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, IMAGE
from sfr_loc_map.suite_names import SIDES, Task
from sfr_loc_map.topics import RAW, RECTIFIED

_log = logging.getLogger(__name__)

HALVED_AXIS = {"side_by_side": 1, "top_bottom": 0}  #: Axis along which a joint image is halved, by its layout.


def image_name(bag: Bag, rig: str) -> str | None:
    """Return the last part of the names of a rig's image topics: `image_rect`, else `image_raw`; else None."""
    for name in (RECTIFIED, RAW):
        if any(bag.find(f"{rig}/{side}/{name}", IMAGE, COMPRESSED) for side in SIDES):
            return name
    return None


def require_topic(bag: Bag, name: str, *msgtypes: str) -> Topic:
    """Return the topic of a relative name; InputError if the bag does not have it."""
    topic = bag.find(name, *msgtypes)
    if topic is None:
        raise InputError(
            f"bag '{bag.path}' has no topic '{name}': it has {', '.join(sorted(bag.topics))};",
            "record it, or name it with --remap old:=new",
        )
    return topic


@dataclass(frozen=True, slots=True)
class CameraTopics:
    """The topics of the cameras of a task in a bag, and the decoding of their messages."""

    bag: Bag
    task: Task
    layout: str  #: Layout of joint images, a key of `HALVED_AXIS`; empty for one topic per camera.
    images: tuple[Topic, ...]  #: Left and right; a single topic of joint images.
    infos: tuple[Topic, ...]  #: Topics of camera_info, left and right; empty if a file has the calibration.
    are_rectified: bool

    @classmethod
    def of(cls, bag: Bag, task: Task, calibration: CalibrationConfig) -> CameraTopics:
        """Return the topics of a task; InputError if a topic is missing."""
        name = image_name(bag, task.rig)
        sides = SIDES[:1] if calibration.stereo_layout else SIDES
        images = tuple(require_topic(bag, f"{task.rig}/{side}/{name}", IMAGE, COMPRESSED) for side in sides)
        infos: tuple[Topic, ...] = ()
        if not calibration.file:
            infos = tuple(require_topic(bag, f"{task.rig}/{side}/camera_info", CAMERA_INFO) for side in SIDES)
        return cls(bag, task, calibration.stereo_layout, images, infos, name == RECTIFIED)

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
                "px cannot be divided into equal halves:",
                "correct the layout or the images",
            )
        left, right = np.split(image, 2, axis)
        return np.ascontiguousarray(left), np.ascontiguousarray(right)

    def check_one_calibration(self, topic: Topic, messages: Iterable[bytes]) -> None:
        """Raise InputError if the messages of a camera_info topic contain several calibrations of the images.

        Differences that change no pixel (`RectifiableCamera.is_same`) are those of rounding.
        """
        with naming(self.bag.path):
            cameras = [self._camera_of(topic, self.bag.deserialise(topic, raw)) for raw in sorted(messages)]
        if not all(camera.is_same(cameras[0]) for camera in cameras):
            raise InputError(
                f"bag '{self.bag.path}', '{topic.bag_name}': the calibration changes within the bag:",
                "divide the bag at the change, or give a constant calibration by --calibration FILE",
            )

    def _camera_of(self, topic: Topic, info: Any) -> RectifiableCamera:  # noqa: ANN401 - types of rosbags
        """Return the calibration of the images in a camera_info; that of rectified images is P alone."""
        if not self.are_rectified:
            return RectifiableCamera.of(topic.name, info)
        return RectifiableCamera.of_rectified_info(topic.name, info)


@dataclass(frozen=True, slots=True, eq=False)
class BagCameras:
    """The calibrated cameras of a task in a bag."""

    rig: StereoRig  #: Rig of the rectified images, with its pose on the rover if the calibration file has it.
    rectifier: StereoRectifier | None  #: None if the images need no rectification.
    frame: str  #: Frame of the left camera.
    text: str  #: Origin of the calibration.


def calibrated_cameras(topics: CameraTopics, calibration: CalibrationConfig) -> BagCameras:
    """Return the cameras of a task by the first message of their topics; `calibration` applies to this task."""
    if calibration.file:
        return _by_file(topics, calibration)
    return _by_camera_info(topics, calibration.baseline_m)


def _by_file(topics: CameraTopics, calibration: CalibrationConfig) -> BagCameras:
    """Return the cameras of a calibration file. The first left or joint image gives their image size and frame."""
    bag, task = topics.bag, topics.task
    topic = topics.images[0]
    message = bag.first([topic]).get(topic.name)
    if message is None:
        raise InputError(f"bag '{bag.path}' has no message on '{topic.bag_name}'")
    image = topics.decoded(topic, message).grey()
    if topics.layout:
        image, _ = topics.left_and_right([image])
    height, width = image.shape
    stereo = read_calibration(Path(calibration.file), (width, height), calibration.baseline_m)
    if not topics.layout:
        left_name, right_name = (each.bag_name for each in topics.images)
        sides = " and ".join(f"{task.rig}/{side}" for side in SIDES)
        with naming(bag.path):
            stereo.pair.check_images(left_name, right_name, f"Exchange the topics of {sides} in 'topics' of sfr.yaml")
    return BagCameras(stereo.rig, stereo.rectifier, str(message.header.frame_id), stereo.pair.text)


def _by_camera_info(topics: CameraTopics, baseline_m: float) -> BagCameras:
    """Return the cameras of the first camera_info of both sides; a `baseline_m` above 0 is the configured baseline."""
    bag = topics.bag
    infos = bag.first(topics.infos)
    for topic in topics.infos:
        if topic.name not in infos:
            raise InputError(
                f"bag '{bag.path}' has no message on '{topic.bag_name}': the rig is unknown;", "record this topic"
            )
    left, right = (infos[topic.name] for topic in topics.infos)
    with naming(bag.path):
        if baseline_m:
            right = replace(right, p=with_baseline(left.p, right.p, baseline_m, "camera_info"))
        rig, rectifier = rig_of_infos((left, right), topics.task.rig, raw=not topics.are_rectified)
    return BagCameras(rig, rectifier, str(left.header.frame_id), "camera_info")


def mount_of(bag: Bag, cameras: BagCameras, base_frame: str) -> RigInBody | None:
    """Return the pose of the drive's cameras on the rover in a bag, in the frame `base_frame` if this is not empty."""
    mount = read_extrinsics(bag, cameras.frame, cameras.rig.baseline_m, base_frame)
    if mount is None and base_frame:
        _log.warning(
            f"bag '{bag.path}': frames.base is '{base_frame}', but /tf_static does not connect this frame to "
            f"'{cameras.frame}', the frame of the left camera: the extrinsics are unknown"
        )
    return mount
