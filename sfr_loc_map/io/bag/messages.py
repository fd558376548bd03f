"""Conversion of the suite's values to ROS messages for bags (names and frames: docs/conventions.md)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.calibration.projections import projection
from sfr_loc_map.io.clouds.point_image import FLOAT32
from sfr_loc_map.io.image_codec import encode_jpeg
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, IMAGE, ODOMETRY, POINTS, POSE, TF
from sfr_loc_map.suite_names import Side

_T = TYPESTORE.types


def header(stamp_ns: int, frame: str) -> Any:  # noqa: ANN401 - rosbags creates the types at run time
    """Return a std_msgs/Header."""
    if not 0 <= stamp_ns < 2**31 * NS_PER_S:
        raise OutputError(f"stamp {stamp_ns} ns does not fit a ROS message: 0 to 2^31 seconds is required")
    time = _T["builtin_interfaces/msg/Time"](*divmod(stamp_ns, NS_PER_S))
    return _T["std_msgs/msg/Header"](time, frame)


def image(stamp_ns: int, image: GreyImage, task: str, side: Side) -> Any:  # noqa: ANN401
    """Return a mono8 sensor_msgs/Image."""
    height, width = image.shape
    data = np.ascontiguousarray(image).reshape(-1)
    return _T[IMAGE](header(stamp_ns, _optical(task, side)), height, width, "mono8", 0, width, data)


def jpeg_image(stamp_ns: int, image: GreyImage, task: str, side: Side, quality: int) -> Any:  # noqa: ANN401
    """Return a JPEG sensor_msgs/CompressedImage."""
    data = np.frombuffer(encode_jpeg(image, quality), np.uint8)
    return _T[COMPRESSED](header(stamp_ns, _optical(task, side)), "mono8; jpeg compressed ", data)


def camera_info(stamp_ns: int, rig: StereoRig, task: str, side: Side) -> Any:  # noqa: ANN401
    """Return the sensor_msgs/CameraInfo of a rectified camera."""
    return _T[CAMERA_INFO](
        header=header(stamp_ns, _optical(task, side)),
        height=rig.height,
        width=rig.width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=rig.camera_matrix.reshape(-1),
        r=np.eye(3).reshape(-1),
        p=projection(rig, side),
        binning_x=0,
        binning_y=0,
        roi=_T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
    )


def pose(stamp_ns: int, T_lm_navsb: Transform) -> Any:  # noqa: ANN401
    """Return the geometry_msgs/PoseStamped of NAVSB in LM."""
    return _T[POSE](header(stamp_ns, "lm"), _pose(T_lm_navsb.translation, T_lm_navsb.file_quat_xyzw))


def odometry(stamp_ns: int, position: FloatArray, quat_xyzw: FloatArray) -> Any:  # noqa: ANN401
    """Return the nav_msgs/Odometry of RB in DS; the twist is unknown and zero."""
    zero = _T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = _T["geometry_msgs/msg/TwistWithCovariance"](_T["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36))
    pose = _T["geometry_msgs/msg/PoseWithCovariance"](_pose(position, quat_xyzw), np.zeros(36))
    return _T[ODOMETRY](header(stamp_ns, "ds"), "rb", pose, twist)


def points(stamp_ns: int, truth: NDArray[np.float32], grid_m: float | None) -> Any:  # noqa: ANN401
    """Return points `(H, W, 3)` in LM as PointCloud2; NaN for no point.

    If `grid_m`, a power of two, is given, the coordinates are rounded to its multiples.
    """
    if grid_m is not None:
        if not (grid_m > 0 and math.frexp(grid_m)[0] == 0.5):
            raise OutputError(
                f"the grid of the true points is {grid_m} m: a power of two is required, such as 0.0009765625"
            )
        truth = (np.round(truth.astype(np.float64) / grid_m) * grid_m).astype(np.float32)
    height, width, _ = truth.shape
    fields = [_T["sensor_msgs/msg/PointField"](name, 4 * i, FLOAT32, 1) for i, name in enumerate("xyz")]
    data = np.ascontiguousarray(truth, "<f4").view(np.uint8).reshape(-1)
    return _T[POINTS](header(stamp_ns, "lm"), height, width, fields, False, 12, 12 * width, data, False)


def static_transforms(stamp_ns: int, rig: StereoRig) -> Any:  # noqa: ANN401
    """Return the TFMessage locsb -> both optical frames, and rb -> locsb if the extrinsics are known."""
    left = rig.T_sb_left
    right = Transform(left.rotation, -left.translation)
    edges = [("locsb", "loc_left_optical", left), ("locsb", "loc_right_optical", right)]
    if rig.T_rb_sb is not None:
        edges.insert(0, ("rb", "locsb", rig.T_rb_sb))
    return _T[TF]([_transform(stamp_ns, *pose) for pose in edges])


def _transform(stamp_ns: int, parent: str, child: str, T_parent_child: Transform) -> Any:  # noqa: ANN401
    vector = _T["geometry_msgs/msg/Vector3"](*T_parent_child.translation.tolist())
    quat = _T["geometry_msgs/msg/Quaternion"](*T_parent_child.file_quat_xyzw.tolist())
    motion = _T["geometry_msgs/msg/Transform"](vector, quat)
    return _T["geometry_msgs/msg/TransformStamped"](header(stamp_ns, parent), child, motion)


def _pose(position: FloatArray, quat_xyzw: FloatArray) -> Any:  # noqa: ANN401
    point = _T["geometry_msgs/msg/Point"](*position.tolist())
    return _T["geometry_msgs/msg/Pose"](point, _T["geometry_msgs/msg/Quaternion"](*quat_xyzw.tolist()))


def _optical(task: str, side: Side) -> str:
    return f"{task}_{side}_optical"
