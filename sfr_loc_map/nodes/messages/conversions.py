"""Messages to values and back: pure functions, no node needed.

Two traps are handled here and nowhere else. The ROS orientation of RB in DS takes components in RB to DS, so it is
`Transform.quat_xyzw`, the conjugate of the source document's `att_q_DsToRb`. And every field gets a plain Python
number: message classes take numpy's without a word and send something else.
"""

from __future__ import annotations

from array import array
from typing import Any, Literal

import numpy as np
import simplejpeg
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image, PointCloud2, PointField, RegionOfInterest
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from sfr_loc_map.constants import LOST_VARIANCE, NS_PER_S
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import (
    JPEG_MAGIC,
    PNG_MAGIC,
    image_from_compressed_message,
    image_from_message,
    stamp_of,
)
from sfr_loc_map.localisation.estimate import PoseEstimate

MAX_POSITION_M = 1e9
"""Farther positions are not believed: their squares would swamp every sum."""
POINT_TYPES: dict[type[np.generic], int] = {
    np.int8: PointField.INT8,
    np.uint8: PointField.UINT8,
    np.int16: PointField.INT16,
    np.uint16: PointField.UINT16,
    np.int32: PointField.INT32,
    np.uint32: PointField.UINT32,
    np.float32: PointField.FLOAT32,
    np.float64: PointField.FLOAT64,
}
"""Codes of sensor_msgs/PointField."""
_POINT_DTYPES = {code: kind for kind, code in POINT_TYPES.items()}


def time_msg(stamp_ns: int) -> Time:
    """Return nanoseconds as a ROS time, exactly."""
    sec, nanosec = divmod(int(stamp_ns), NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def header_msg(stamp_ns: int, frame_id: str) -> Header:
    """Return a header."""
    return Header(stamp=time_msg(stamp_ns), frame_id=frame_id)


def pose_msg(pose: Transform, quat_xyzw: FloatArray) -> Pose:
    """Return a pose of the child frame in the parent frame; the quaternion is sent as given."""
    x, y, z = (float(v) for v in pose.translation)
    qx, qy, qz, qw = (float(v) for v in quat_xyzw)
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def transform_from_pose(pose: Pose, name: str) -> Transform:
    """Return `T_parent_child` of a pose message.

    Args:
        pose: geometry_msgs/Pose.
        name: What it is, for the message of an error.

    Raises:
        InputError: If a number is not finite, the position is absurd or the quaternion is not of unit length within
            1e-3 (an empty message has none).
    """
    position = np.array([pose.position.x, pose.position.y, pose.position.z])
    q = pose.orientation
    quat = np.array([q.x, q.y, q.z, q.w])
    if not (np.isfinite(position).all() and np.isfinite(quat).all()):
        raise InputError(f"{name} has a number that is not finite: a position and a unit quaternion are needed")
    if np.abs(position).max() > MAX_POSITION_M:
        raise InputError(f"{name} lies more than {MAX_POSITION_M:g} m away: a position in metres is needed")
    length = float(np.hypot(np.hypot(q.x, q.y), np.hypot(q.z, q.w)))
    if abs(length - 1.0) > 1e-3:
        raise InputError(f"{name} has a quaternion of length {length:.4g}: a unit quaternion is needed")
    return Transform.from_quat(position, quat)


def odometry_msg(estimate: PoseEstimate, parent: str, child: str) -> Odometry:
    """Return an estimate as odometry; the velocity is not estimated and says so by its covariance."""
    message = Odometry(header=header_msg(estimate.stamp_ns, parent), child_frame_id=child)
    message.pose.pose = pose_msg(estimate.T_ds_rb, estimate.T_ds_rb.quat_xyzw)
    message.pose.covariance = np.array(estimate.covariance, dtype=np.float64).reshape(36)
    message.twist.covariance = (np.eye(6) * LOST_VARIANCE).reshape(36)
    return message


def odometry_row(message: Odometry) -> tuple[int, tuple[float, float, float], tuple[float, float, float, float]]:
    """Return stamp (ns), position (m) and quaternion (x, y, z, w) of odometry, numbers as sent.

    Raises:
        InputError: If they are not a pose.
    """
    stamp = stamp_of(message)
    transform_from_pose(message.pose.pose, f"odometry of stamp {stamp}")
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return stamp, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


def grey_from_image(message: Image | CompressedImage, size: tuple[int, int]) -> GreyImage:
    """Return an image message as 8-bit grey `(H, W)`.

    Args:
        message: sensor_msgs/Image or CompressedImage (PNG or JPEG).
        size: Width and height that the camera_info says.

    Raises:
        InputError: If the size is another, the encoding is not read or the data is broken.
    """
    check_image(message, size)
    return image_from_message(message) if isinstance(message, Image) else image_from_compressed_message(message)


def check_image(message: Image | CompressedImage, size: tuple[int, int]) -> None:
    """Check what a picture claims to be, before anything is decoded or allocated: a small message may claim any size.

    Args:
        message: sensor_msgs/Image or CompressedImage (PNG or JPEG).
        size: Width and height that the camera_info says.

    Raises:
        InputError: If the size is another or the picture is a Bayer mosaic.
    """
    if isinstance(message, Image):
        found: tuple[int, int] | None = (int(message.width), int(message.height))
    else:
        found = compressed_size(bytes(message.data))
    if found != size:
        what = "not PNG or JPEG" if found is None else f"{found[0]} x {found[1]}"
        raise InputError(
            f"image of stamp {stamp_of(message)} is {what}: its camera_info says {size[0]} x {size[1]}; "
            f"publish the camera_info of these pictures"
        )
    if isinstance(message, Image) and message.encoding.startswith("bayer_"):
        raise InputError(
            f"image of stamp {stamp_of(message)} has encoding '{message.encoding}': Bayer mosaics are not supported; "
            f"debayer and rectify it before (image_proc), and give image_rect"
        )


def compressed_size(data: bytes) -> tuple[int, int] | None:
    """Return width and height that the header of a PNG or JPEG file claims, None where there is no such header."""
    if data.startswith(PNG_MAGIC) and len(data) >= 24:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if data.startswith(JPEG_MAGIC):
        try:
            height, width, *_ = simplejpeg.decode_jpeg_header(data)
        except ValueError:
            return None
        return int(width), int(height)
    return None


def cloud_msg(cloud: PointCloud, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a cloud with the fields x y z sigma intensity u v pair, one row."""
    message = _packed_cloud(cloud.to_structured(), stamp_ns, frame_id)
    message.is_dense = bool(np.isfinite(cloud.xyz).all())
    return message


def cloud_from_msg(message: PointCloud2) -> PointCloud:
    """Return the cloud of a message with at least the fields of `mapping/points`.

    Raises:
        InputError: If a field is missing or of another type, or the data is too short.
    """
    records = _records(message, FIELD_TYPES)
    return PointCloud.from_structured(records.reshape(-1))


def disparity_msg(
    disparity_px: NDArray[np.float32], rig: StereoRig, searched_px: tuple[float, float], header: Header
) -> DisparityImage:
    """Return a disparity image.

    Args:
        disparity_px: `(H, W)` float32, pixels, NaN where none; sent as a value below the smallest searched, as
            the message's definition has it.
        rig: Its rig.
        searched_px: Smallest and largest disparity looked for.
        header: Header of the message.
    """
    height, width = disparity_px.shape
    low = min(searched_px[0], float(np.nanmin(disparity_px, initial=np.inf)))
    filled = np.where(np.isnan(disparity_px), np.float32(low - 1.0), disparity_px).astype("<f4")
    message = DisparityImage(header=header, f=float(rig.fx), t=float(rig.baseline_m), delta_d=1.0 / 16.0)
    message.image = Image(header=header, height=height, width=width, encoding="32FC1", step=4 * width)
    message.image.data = _bytes(filled)
    message.valid_window = RegionOfInterest(height=height, width=width)
    message.min_disparity, message.max_disparity = float(low), float(searched_px[1])
    return message


def image_msg(picture: NDArray[np.uint8], header: Header) -> Image:
    """Return a colour picture `(H, W, 3)` uint8, blue, green, red, as a message."""
    height, width = picture.shape[:2]
    message = Image(header=header, height=height, width=width, encoding="bgr8", step=3 * width)
    message.data = _bytes(picture)
    return message


def disparity_from_msg(message: DisparityImage) -> NDArray[np.float32]:
    """Return a disparity image `(H, W)` float32, pixels, NaN where none.

    Raises:
        InputError: If it is not 32FC1 or the data is too short.
    """
    image = message.image
    height, width = int(image.height), int(image.width)
    if image.encoding != "32FC1" or image.step != 4 * width or len(image.data) != 4 * width * height:
        raise InputError(
            f"disparity of stamp {stamp_of(message)} is {image.encoding} {width} x {height}: whole 32FC1 is needed"
        )
    values = np.frombuffer(image.data, ">f4" if image.is_bigendian else "<f4").astype(np.float32)
    values[values < message.min_disparity] = np.nan
    return values.reshape(height, width)


def _packed_cloud(records: NDArray[np.void], stamp_ns: int, frame_id: str) -> PointCloud2:
    dtype = records.dtype
    offsets = {name: (dtype[name].type, int(dtype.fields[name][1])) for name in dtype.names or () if dtype.fields}
    fields = [
        PointField(name=name, offset=offset, datatype=POINT_TYPES[kind], count=1)
        for name, (kind, offset) in offsets.items()
    ]
    step = int(records.dtype.itemsize)
    message = PointCloud2(header=header_msg(stamp_ns, frame_id), height=1, width=len(records), fields=fields)
    message.point_step, message.row_step = step, step * len(records)
    message.data = _bytes(records)
    return message


def _records(message: PointCloud2, wanted: dict[str, type[np.generic]]) -> NDArray[np.void]:
    """Return the wanted fields of a cloud `(height, width)` without copying."""
    found = {field.name: field for field in message.fields}
    stamp, step, row = stamp_of(message), int(message.point_step), int(message.row_step)
    for name, kind in wanted.items():
        field = found.get(name)
        if field is None or _POINT_DTYPES.get(field.datatype) is not kind or field.count not in (0, 1):
            have = ", ".join(found) or "none"
            raise InputError(f"cloud of stamp {stamp} has no field '{name}' of {kind.__name__} (fields: {have})")
        if field.offset + np.dtype(kind).itemsize > step:
            raise InputError(f"cloud of stamp {stamp}: field '{name}' lies beyond the point's {step} bytes")
    height, width = int(message.height), int(message.width)
    if row < step * width or len(message.data) < row * height:
        raise InputError(
            f"cloud of stamp {stamp} is {width} x {height} points of {step} bytes in {len(message.data)}: too few"
        )
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    dtype = np.dtype(
        {
            "names": list(wanted),
            "formats": [np.dtype(kind).newbyteorder(order) for kind in wanted.values()],
            "offsets": [int(found[name].offset) for name in wanted],
            "itemsize": step,
        }
    )
    if height * width == 0:
        return np.zeros((0, 0), dtype)
    flat = np.frombuffer(message.data, np.uint8)
    return np.ndarray((height, width), dtype, buffer=flat.data, strides=(row, step))


def _bytes(values: NDArray[Any]) -> array[int]:
    """Return the bytes of an array as the one type that message fields take quickly."""
    data = array("B")
    data.frombytes(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data if values.size else b"")
    return data
