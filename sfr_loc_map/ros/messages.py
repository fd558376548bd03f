"""Convert values to messages and back: stamps, poses, images, clouds, grids, tracks.

Every field is set to a plain Python number, because message classes accept numpy numbers silently and send wrong
values. Invalid messages (NaN, too few bytes, a wrong size or type) raise an InputError.

The ROS orientation of RB in DS rotates components from RB to DS. This orientation is therefore `Transform.quat_xyzw`,
the conjugate of the source document's `att_q_DsToRb`.
"""

from __future__ import annotations

import importlib
from array import array
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from nav_msgs.msg import MapMetaData, OccupancyGrid, Odometry
from numpy.typing import NDArray
from rclpy.time import Time
from sensor_msgs.msg import CompressedImage, Image, PointCloud2, PointField, RegionOfInterest
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from sfr_loc_map.errors import GeometryError, InputError, NodeError
from sfr_loc_map.geometry.arrays import FloatArray, FloatArray32
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE, MAX_VARIANCE, check_image_size, is_plausible_covariance
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.images.codec import JPEG_MAGIC, PNG_MAGIC, claimed_size, unread_codec
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose, StepEstimate
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_text import alternatives

if TYPE_CHECKING:  # nodes without kernels do not import numba
    from sfr_loc_map.mapping.search_range import SearchRange
    from sfr_loc_map.mapping.terrain.terrain_grid import TerrainGrid

_LETTERS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
POINT_TYPES = {np.dtype(name).type: code for code, name in enumerate(_LETTERS, PointField.INT8)}
"""Datatype codes of sensor_msgs/PointField by numpy type."""


def header_msg(stamp_ns: int, frame_id: str) -> Header:
    """Return a header with a stamp and a frame."""
    return Header(stamp=Time(nanoseconds=int(stamp_ns)).to_msg(), frame_id=frame_id)


def byte_array(values: NDArray[Any]) -> array[int]:
    """Return the bytes of an array as `array.array`, the only type that message fields copy fast."""
    data = array("B")
    data.frombytes(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
    return data


def points_msg(records: NDArray[np.void], header: Header) -> PointCloud2:
    """Return structured points `(N,)` or `(H, W)` as a message with aligned fields and `is_dense` false."""
    dtype, shape = np.dtype(records.dtype.descr, align=True), (1, *records.shape)[-2:]
    layout: Mapping[str, Any] = dtype.fields or {}
    fields = [
        PointField(name=name, offset=int(offset), datatype=POINT_TYPES[kind.type], count=1)
        for name, (kind, offset, *_) in layout.items()
    ]
    size = int(dtype.itemsize)
    message = PointCloud2(header=header, height=shape[0], width=shape[1], fields=fields)
    message.point_step, message.row_step = size, size * shape[1]
    message.data = byte_array(records.astype(dtype))
    return message


def points_of(message: PointCloud2, wanted: Mapping[str, Sequence[type[np.generic]]]) -> NDArray[np.void]:
    """Return a view of the points `(H, W)` of a message with the wanted fields; the message may have any layout."""
    what, found = f"cloud of stamp {stamp_of(message)}", {field.name: field for field in message.fields}
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    formats, offsets = [], []
    for name, kinds in wanted.items():
        field = found.get(name)
        kind = next((k for k in kinds if field is not None and field.datatype == POINT_TYPES[k]), None)
        if field is None or kind is None or field.count not in (0, 1):
            types = alternatives(each.__name__ for each in kinds)
            raise InputError(f"{what} has no field '{name}' of {types} (fields: {', '.join(found) or 'none'})")
        formats.append(np.dtype(kind).newbyteorder(order))
        offsets.append(int(field.offset))
        if field.offset + formats[-1].itemsize > message.point_step:
            raise InputError(f"{what}: field '{name}' ends after the {message.point_step} bytes of a point")
    height, width, step, row = (int(n) for n in (message.height, message.width, message.point_step, message.row_step))
    if row < step * width or len(message.data) < row * height:
        raise InputError(
            f"{what} has {len(message.data)} bytes: {width} x {height} points of {step} bytes are required"
        )
    dtype = np.dtype({"names": list(wanted), "formats": formats, "offsets": offsets, "itemsize": step})
    if not height * width:
        return np.zeros((height, width), dtype)
    return np.ndarray((height, width), dtype, np.frombuffer(message.data, np.uint8).data, strides=(row, step))


def float_points_msg(values: FloatArray32, names: Sequence[str], header: Header) -> PointCloud2:
    """Return float32 values `(N, F)` or `(H, W, F)` as a cloud with F fields."""
    rows = np.ascontiguousarray(values, "<f4").view([(name, "<f4") for name in names])[..., 0]
    return points_msg(rows, header)


def floats_of(message: PointCloud2, names: Sequence[str]) -> FloatArray32:
    """Return the named float32 fields of a cloud as `(H, W, F)`."""
    points = points_of(message, dict.fromkeys(names, (np.float32,)))
    return np.stack([points[name].astype(np.float32) for name in names], axis=-1)


FIRST_VELOCITY_VARIANCE = 1.0  #: Variance of the unknown velocity at the first pose, (m/s)^2 and (rad/s)^2.


def pose_msg(pose: Transform, quat_xyzw: FloatArray) -> Pose:
    """Return the pose of the child frame in the parent frame; the quaternion is sent as given."""
    x, y, z = (float(v) for v in pose.translation)
    qx, qy, qz, qw = (float(v) for v in quat_xyzw)
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def transform_from_pose(pose: Pose, name: str) -> Transform:
    """Return `T_parent_child` of a pose message; `name` describes the pose in the error message."""
    p, q = pose.position, pose.orientation
    try:
        return Transform.from_quat((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
    except GeometryError as error:
        raise InputError(f"{name}: {error}") from error


def start_pose_of(message: PoseWithCovarianceStamped) -> StartPose:
    """Return an external pose, which applies at its stamp; a stamp of 0 means that the time is unknown."""
    pose = transform_from_pose(message.pose.pose, "initialpose")
    covariance = np.array(message.pose.covariance, np.float64).reshape(6, 6)
    if not is_plausible_covariance(covariance):
        raise InputError(
            "initialpose: invalid covariance: a symmetric and positive semi-definite matrix is required, with "
            f"variances from 0 to {MAX_VARIANCE:g}; zeros mean an exact pose"
        )
    return StartPose(pose, covariance, stamp_of(message) or None)


def odometry_msg(estimate: PoseEstimate, parent: str, child: str) -> Odometry:
    """Return an estimate as odometry; the velocity is the mean since the previous pose, in RB of the previous pose."""
    message = Odometry(header=header_msg(estimate.stamp_ns, parent), child_frame_id=child)
    message.pose.pose = pose_msg(estimate.T_ds_rb, estimate.T_ds_rb.quat_xyzw)
    message.pose.covariance = np.array(estimate.covariance, dtype=np.float64).reshape(36)
    message.twist = _twist_msg(estimate.step)
    return message


def _twist_msg(step: StepEstimate | None) -> TwistWithCovariance:
    """Return the mean velocity of a step; without a step, zero with a covariance of 9999 on the diagonal."""
    if step is None:
        return TwistWithCovariance(covariance=(np.eye(6) * LOST_VARIANCE).reshape(36))
    velocity, covariance = np.zeros(6), np.eye(6) * FIRST_VELOCITY_VARIANCE
    if step.seconds > 0.0:
        velocity, covariance = step.motion / step.seconds, step.motion_covariance / step.seconds**2
    x, y, z, roll, pitch, yaw = velocity.tolist()
    twist = Twist(linear=Vector3(x=x, y=y, z=z), angular=Vector3(x=roll, y=pitch, z=yaw))
    return TwistWithCovariance(twist=twist, covariance=covariance.reshape(36))


OdometryRow = tuple[int, tuple[float, float, float], tuple[float, float, float, float]]
"""Stamp (ns), position (m) and quaternion (x, y, z, w) of odometry, as sent."""


def odometry_row(message: Odometry) -> OdometryRow:
    """Return stamp and pose of odometry; raise an InputError if the pose is invalid."""
    stamp = stamp_of(message)
    p, q = message.pose.pose.position, message.pose.pose.orientation
    place, quat = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
    with refusing(f"odometry of stamp {stamp}", "correct the publisher"):
        Transform.from_quat(place, quat)
    return stamp, place, quat


def covariance_of(message: Odometry) -> FloatArray:
    """Return the covariance `(6, 6)` of the pose of odometry, in ROS order."""
    return np.array(message.pose.covariance, np.float64).reshape(6, 6)


def transform_msg(header: Header, child: str, pose: Pose) -> TransformStamped:
    """Return the pose of a frame as a transform."""
    transform = TransformStamped(header=header, child_frame_id=child)
    transform.transform.translation = Vector3(x=pose.position.x, y=pose.position.y, z=pose.position.z)
    transform.transform.rotation = pose.orientation
    return transform


def tf_message_type() -> type[Any] | None:
    """Return tf2_msgs/TFMessage; None if tf2_msgs is not installed (it is not part of the ROS wheels)."""
    try:
        return message_type("tf2_msgs/msg/TFMessage")
    except NodeError:
        return None


def check_image(message: Image | CompressedImage, size: tuple[int, int]) -> None:
    """Check the size that an image claims before memory is allocated, because a small message may claim any size."""
    if isinstance(message, Image):
        found: tuple[int, int] | None = (int(message.width), int(message.height))
    else:
        data = bytes(message.data)
        found = claimed_size(data) if data.startswith((PNG_MAGIC, JPEG_MAGIC)) else None
    if found != size:
        if found is None:
            text = f"image of stamp {stamp_of(message)}: {unread_codec(message)}: publish raw images, PNG or JPEG"
            raise InputError(text)
        raise InputError(
            f"image of stamp {stamp_of(message)} is {found[0]} x {found[1]}: its camera_info states {size[0]} x "
            f"{size[1]}; publish the camera_info of these images"
        )


def image_msg(pixels: NDArray[np.generic], encoding: str, header: Header) -> Image:
    """Return an image `(H, W)` or `(H, W, C)` as a message with an encoding."""
    height, width = pixels.shape[:2]
    step = pixels.nbytes // max(height, 1)
    return Image(header=header, height=height, width=width, encoding=encoding, step=step, data=byte_array(pixels))


def disparity_msg(
    disparity_px: NDArray[np.float32], rig: StereoRig, searched: SearchRange, header: Header
) -> DisparityImage:
    """Return a disparity image; its range includes the search range and all valid disparities."""
    height, width = disparity_px.shape
    low = min(searched.min_disparity_px, float(np.nanmin(disparity_px, initial=np.inf)))
    high = max(searched.max_disparity_px, float(np.nanmax(disparity_px, initial=-np.inf)))
    filled = np.where(np.isnan(disparity_px), np.float32(low - 1.0), disparity_px).astype("<f4")
    message = DisparityImage(header=header, f=float(rig.fx), t=float(rig.baseline_m), delta_d=1.0 / 16.0)
    message.image = image_msg(filled, "32FC1", header)
    message.valid_window = RegionOfInterest(height=height, width=width)
    message.min_disparity = float(low)
    message.max_disparity = float(high)
    return message


def cloud_msg(cloud: PointCloud, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a cloud as one row of points with the fields x, y, z, sigma, intensity, u, v, pair."""
    message = points_msg(cloud.to_structured(), header_msg(stamp_ns, frame_id))
    message.is_dense = bool(np.isfinite(cloud.xyz).all())
    return message


def cloud_from_msg(message: PointCloud2) -> PointCloud:
    """Return the cloud of a message with at least the fields of `mapping/points`."""
    points = points_of(message, {name: (kind,) for name, kind in FIELD_TYPES.items()})
    return PointCloud.from_structured(points.reshape(-1))


def xyz_from_msg(message: PointCloud2) -> FloatArray:
    """Return the points `(N, 3)` of any cloud with float fields x, y and z; missing points stay NaN."""
    points = points_of(message, dict.fromkeys("xyz", (np.float32, np.float64)))
    return np.stack([points[name].reshape(-1).astype(np.float64) for name in "xyz"], axis=1)


ELEVATION_FIELDS = ("x", "y", "z", "sigma", "slope", "roughness", "step", "count")
"""Float32 fields of a cell: centre, height and sigma, m; slope, rad; roughness and step, m; number of points."""


def elevation_msg(grid: TerrainGrid, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a grid as an organised cloud: one point per cell, rows along y, columns along x, NaN for unknown."""
    (rows, columns), (x0, y0), cell_m = grid.hazard.shape, grid.elevation.origin_m, grid.elevation.cell_m
    cells = np.empty((rows, columns, len(ELEVATION_FIELDS)), np.float32)
    cells[..., 0] = x0 + (np.arange(columns) + 0.5) * cell_m
    cells[..., 1] = (y0 + (np.arange(rows) + 0.5) * cell_m)[:, None]
    model = grid.elevation
    layers = (model.height_m, model.sigma_m, grid.slope_rad, grid.roughness_m, grid.step_m, model.count)
    for index, layer in enumerate(layers, 2):
        cells[..., index] = layer
    return float_points_msg(cells, ELEVATION_FIELDS, header_msg(stamp_ns, frame_id))


def elevation_from_msg(message: PointCloud2) -> FloatArray32:
    """Return the cells `(R, C, 8)` of a message of `elevation_msg`, in the order of `ELEVATION_FIELDS`."""
    check_image_size(int(message.width), int(message.height), "the elevation grid")
    cells = floats_of(message, ELEVATION_FIELDS)
    if not np.isfinite(cells[..., :2]).all():
        raise InputError("elevation has cells without a position: finite x and y are required")
    return cells


def hazard_msg(grid: TerrainGrid, stamp_ns: int, frame_id: str) -> OccupancyGrid:
    """Return the hazard of the cells: 100 for a hazard, 0 to 99 for traversable cells, -1 for unknown."""
    (rows, columns), (x0, y0) = grid.hazard.shape, grid.elevation.origin_m
    header = header_msg(stamp_ns, frame_id)
    origin = Pose(position=Point(x=float(x0), y=float(y0), z=0.0), orientation=Quaternion(w=1.0))
    resolution = float(np.float32(grid.elevation.cell_m))
    info = MapMetaData(map_load_time=header.stamp, resolution=resolution, width=columns, height=rows, origin=origin)
    return OccupancyGrid(header=header, info=info, data=array("b", grid.hazard.tobytes()))


def hazard_from_msg(message: OccupancyGrid) -> FloatArray32:
    """Return the hazard `(R, C)` from 0 to 100, NaN for unknown cells."""
    rows, columns = int(message.info.height), int(message.info.width)
    data = np.frombuffer(message.data, np.int8)
    if len(data) != rows * columns:
        raise InputError(f"hazard has {len(data)} values: one for each of {columns} x {rows} cells is required")
    return np.where(data < 0, np.nan, data).astype(np.float32).reshape(rows, columns)


TRACK_FIELDS = ("u", "v", "before_u", "before_v", "residual")
"""Float32 fields of a track: pixel in the left image of the pair, pixel in the newest keyframe, and residual. The
residual is the root of chi-square per degree of freedom divided by the gate of an inlier (1 and more: outlier; NaN: not
found)."""
MAX_TRACKS = 100_000


def tracks_from_msg(message: PointCloud2) -> FloatArray32:
    """Return tracks `(N, 5)` in the order of `TRACK_FIELDS`."""
    if message.width * message.height > MAX_TRACKS:
        raise InputError(f"{message.width * message.height} tracks: at most {MAX_TRACKS} are allowed")
    return floats_of(message, TRACK_FIELDS).reshape(-1, len(TRACK_FIELDS))


def message_type(msgtype: str) -> type[Any]:
    """Return the class of a name such as `sensor_msgs/msg/Image`; raise a NodeError if its package is missing."""
    package, _, name = msgtype.split("/")
    try:
        found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise NodeError(f"message type {msgtype} is not available: install or source {package}") from error
    return found
