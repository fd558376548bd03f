"""Checks of the arrays in the answer of a mapper under test, which can write anything to its files."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import MAX_CLOUD_BYTES
from sfr_loc_map.io.clouds.array_file import MAX_HEADER, parse_npy
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.methods.point_bounds import check_points
from sfr_loc_map.metrics.figures.records import FindingKind

Arrays = Mapping[str, bytes]
"""Contents of the files of an answer by their suffix."""


def largest_files(rig: StereoRig) -> dict[str, int]:
    """Return the largest sizes of the files of an answer by their suffix, bytes."""
    return {"cloud": MAX_CLOUD_BYTES, "disparity": 8 * rig.width * rig.height + 2 * MAX_HEADER}


def _array(arrays: Arrays, suffix: str, fields: Collection[str] = ()) -> NDArray[Any]:
    try:
        if suffix not in arrays:
            raise ValueError("there is no file")
        return parse_npy(arrays[suffix], fields)
    except ValueError as error:
        raise MethodFailureError(FindingKind.INVALID_RESULT, f"the {suffix} cannot be read: {error}") from error


def disparity_in(arrays: Arrays, rig: StereoRig) -> FloatImage | None:
    """Return the disparity image of an answer, None without one; MethodFailureError if the image is invalid."""
    if "disparity" not in arrays:
        return None
    found: FloatImage = _array(arrays, "disparity")
    shape = (rig.height, rig.width)
    if found.shape != shape:
        text = f"the disparity image has the shape {found.shape}: {shape}, as of the left image, is required"
        raise MethodFailureError(FindingKind.INVALID_RESULT, text)
    if np.isinf(found).any():
        raise MethodFailureError(FindingKind.NOT_FINITE, "a disparity is infinite")
    return found


def cloud_in(arrays: Arrays, rig: StereoRig, pairs: int) -> PointCloud:
    """Return the points of an answer to a call with `pairs` pairs; MethodFailureError if a point is invalid."""
    records = _array(arrays, "cloud", tuple(FIELD_TYPES))
    try:
        cloud = PointCloud.from_structured(records, fused=False)
    except GeometryError as error:
        raise MethodFailureError(FindingKind.INVALID_RESULT, f"the cloud is invalid: {error}") from error
    if not (np.isfinite(cloud.xyz).all() and np.isfinite(cloud.sigma).all()):
        raise MethodFailureError(FindingKind.NOT_FINITE, "a point or its sigma is not finite")
    if len(cloud) and cloud.sigma.min() < 0.0:
        text = f"the sigma of a point is negative: {cloud.sigma.min():g} m"
        raise MethodFailureError(FindingKind.INVALID_RESULT, text)
    try:
        check_points(cloud.u, cloud.v, cloud.pair, (pairs, rig.height, rig.width))
    except ValueError as error:
        raise MethodFailureError(FindingKind.INVALID_RESULT, str(error)) from error
    return cloud
