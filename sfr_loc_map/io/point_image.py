"""The true points of a pair as a message: an organised cloud."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M


def points_image(message: Any, size: tuple[int, int]) -> NDArray[np.float32]:  # noqa: ANN401 - a PointCloud2 of any library
    """Return an organised sensor_msgs/PointCloud2 as `(H, W, 3)` float32, metres.

    Args:
        message: The message.
        size: Width and height of the images of the pair.

    Raises:
        InputError: If it is not of that size, has no float32 x, y, z, or a coordinate is absurd.
    """
    offsets = {field.name: int(field.offset) for field in message.fields if int(field.datatype) == 7}
    shape, step, row = (int(message.height), int(message.width)), int(message.point_step), int(message.row_step)
    size_ok = (shape[1], shape[0]) == size and row >= step * shape[1] and len(message.data) >= row * shape[0]
    if not size_ok or any(name not in offsets or offsets[name] + 4 > step for name in "xyz"):
        raise InputError(
            f"ground_truth/points is {shape[1]} x {shape[0]} with float32 fields {sorted(offsets)}: an organised cloud "
            f"of {size[0]} x {size[1]} with x, y, z is needed"
        )
    order = ">f4" if message.is_bigendian else "<f4"
    layout = np.dtype(
        {"names": list("xyz"), "formats": [order] * 3, "offsets": [offsets[n] for n in "xyz"], "itemsize": step}
    )
    records = np.ndarray(shape, layout, np.frombuffer(message.data, np.uint8), strides=(row, step))
    points = np.stack([records[name].astype("<f4") for name in "xyz"], axis=-1)
    return checked_points(points, "ground_truth/points")


def checked_points(points: NDArray[np.floating], name: str) -> NDArray[np.float32]:
    """Return true points as float32, NaN where a number is not finite.

    Raises:
        InputError: If a coordinate is absurd; `name` says whose.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # a NaN that signals; what is too large for float32
        points = np.array(points, np.float32)
    known = np.isfinite(points)
    points[~known] = np.nan
    if np.abs(points[known]).max(initial=0.0) > MAX_POSITION_M:
        raise InputError(f"{name} has a coordinate beyond {MAX_POSITION_M:g} m; NaN stands for no truth")
    return points
