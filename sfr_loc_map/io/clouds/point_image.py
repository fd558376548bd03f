"""The true points of a mapping pair as an image `(H, W, 3)`: a point, or NaN, for each pixel of the left image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M

FLOAT32 = 7  #: Code of a 32-bit float in sensor_msgs/PointField.


def points_image(message: Any, size: tuple[int, int]) -> NDArray[np.float32]:  # noqa: ANN401 - a PointCloud2 of any library
    """Return an organised sensor_msgs/PointCloud2 of a size (width, height) as `(H, W, 3)` float32, metres."""
    offsets = {field.name: int(field.offset) for field in message.fields if int(field.datatype) == FLOAT32}
    shape, step, row = (int(message.height), int(message.width)), int(message.point_step), int(message.row_step)
    size_ok = (shape[1], shape[0]) == size and row >= step * shape[1] and len(message.data) >= row * shape[0]
    if not size_ok or any(name not in offsets or offsets[name] + 4 > step for name in "xyz"):
        raise InputError(
            f"ground_truth/points is {shape[1]} x {shape[0]} with float32 fields {sorted(offsets)}:",
            f"an organised cloud of {size[0]} x {size[1]} with x, y, z is required",
        )
    order = ">f4" if message.is_bigendian else "<f4"
    layout = np.dtype(
        {"names": list("xyz"), "formats": [order] * 3, "offsets": [offsets[n] for n in "xyz"], "itemsize": step}
    )
    records = np.ndarray(shape, layout, np.frombuffer(message.data, np.uint8), strides=(row, step))
    points = np.stack([records[name].astype("<f4") for name in "xyz"], axis=-1)
    return checked_points(points, "ground_truth/points")


def checked_points(points: NDArray[np.floating], name: str) -> NDArray[np.float32]:
    """Return true points as float32; numbers that are not finite become NaN."""
    with np.errstate(invalid="ignore", over="ignore"):  # for a signalling NaN and for float32 overflow
        points = np.array(points, np.float32)
    known = np.isfinite(points)
    points[~known] = np.nan
    if np.abs(points[known]).max(initial=0.0) > MAX_POSITION_M:
        raise InputError(f"{name} has a coordinate beyond {MAX_POSITION_M:g} m;", "use NaN for a missing truth")
    return points
