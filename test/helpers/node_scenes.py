"""The pairs of `made_scene` as ROS messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, Image
from stereo_msgs.msg import DisparityImage

from helpers.made_scene import START_NS, T_RB_LOCSB
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.io.bag.encoding import TYPESTORE

if TYPE_CHECKING:
    from helpers.peer import Peer


OPTICAL = (-0.5, 0.5, -0.5, 0.5)
"""Attitude of an optical frame in one with x forward and z up: x, y, z, w."""
DRIVERS = {
    "zed": ("zed_camera_link", "zed_camera_center", "zed_left_camera_frame", "zed_left_camera_optical_frame"),
    "realsense": ("camera_link", "camera_infra1_frame", "camera_infra1_optical_frame"),
    "oak-d": ("oak-d-base-frame", "oak-d_frame", "oak_left_camera_frame", "oak_left_camera_optical_frame"),
}
"""Frames of drivers, from that which the rover carries to the left camera."""


def params(*assignments: str) -> list[str]:
    """Return assignments of parameters as arguments of a node."""
    return [word for text in assignments for word in ("-p", text)]


RELIABLE = params("input.reliability:=reliable")
"""For nodes in a process of their own: by best effort the first message after discovery may be lost."""
MOUNT = RELIABLE + params(
    f"T_rb_locsb.translation_m:={T_RB_LOCSB.translation.tolist()}",
    f"T_rb_locsb.quat_xyzw:={T_RB_LOCSB.file_quat_xyzw.tolist()}",
)


def raw(message: Any) -> bytes:
    return bytes(TYPESTORE.serialize_cdr(message, message.__msgtype__))


def send_infos(peer: Peer, name: str, rig: StereoRig, prefix: str = "", stamp_ns: int = START_NS) -> None:
    for side in ("left", "right"):
        message = raw(bag_messages.camera_info(stamp_ns, rig, name, side))
        peer.publish(CameraInfo, f"{prefix}{name}/{side}/camera_info", message)


def send_pair(peer: Peer, rig: str, pair: StereoPair, prefix: str = "") -> None:
    for side, image in (("left", pair.left), ("right", pair.right)):
        message = raw(bag_messages.image(pair.stamp_ns, image, rig, side))
        peer.publish(Image, f"{prefix}{rig}/{side}/image_rect", message)


def calls(diagnostics: list[DiagnosticArray]) -> list[DiagnosticStatus]:
    """Return the statuses that describe calls."""
    return [status for array in diagnostics for status in array.status if status.name.endswith(": call")]


def problems(diagnostics: list[DiagnosticArray]) -> str:
    """Return the unusable inputs and internal faults, a line each."""
    found = [status for array in diagnostics for status in array.status if status.name.endswith((": input", ": fault"))]
    return "\n".join(status.message for status in found)


def sent(message: Any) -> Any:
    """Return a message as it arrives: through its serialised form."""
    return deserialize_message(serialize_message(message), type(message))


def disparity_of(message: DisparityImage) -> np.ndarray:
    """Return the disparities `(H, W)` float32 of a DisparityImage, px; NaN outside of its valid range."""
    values = np.frombuffer(message.image.data, "<f4").reshape(message.image.height, message.image.width)
    return np.where(values < message.min_disparity, np.float32(np.nan), values)
