"""The error of each point of a cloud relative to the true point of its pixel [4.3.4]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics import formulas, other_formulas
from sfr_loc_map.metrics.map.pair_truth import PairTruth, check_points

PIXEL_SAMPLES = 2000  #: Minimum number of points of a pair, if it has so many, that are compared with their pixel.


@dataclass(frozen=True, slots=True, eq=False)
class PointErrors:
    """The errors `(N,)` of points that have a true point, in the order of the cloud."""

    index: NDArray[np.intp]  #: Indices of the points in the cloud.
    error_m: FloatArray  #: Distance from the true point [4.3.4].
    range_m: FloatArray  #: Distance of the true point from the left optical centre.
    #: Component of the error along the ray, positive if the point is too far; NaN if the true point is at the optical
    #: centre.
    along_m: FloatArray
    vertical_m: FloatArray  #: Error along z of LM, positive if the point is too high.
    horizontal_m: FloatArray  #: Norm of the error in the x-y plane of LM.
    disparity_px: FloatArray  #: `f b / Z - f b / Z_true` of the depths Z along the left optical axis; NaN unless Z > 0.


def point_errors(cloud: PointCloud, truths: Sequence[PairTruth]) -> PointErrors:
    """Return the errors of all points whose pixel has a true point.

    MetricsError if a coordinate is not finite, if there is no truth, or if a point is not of this source.
    """
    check_points(cloud.xyz, truths)
    check_pairs(cloud, len(truths))
    parts = [errors_of_pair(cloud, truth, number) for number, truth in enumerate(truths)]
    order = np.argsort(np.concatenate([part.index for part in parts]), kind="stable")
    columns = (field.name for field in fields(PointErrors))
    return PointErrors(**{name: np.concatenate([getattr(part, name) for part in parts])[order] for name in columns})


def check_pairs(cloud: PointCloud, truths: int) -> None:
    """Check that the pair of each point has a truth, and a stamp if the cloud states stamps; MetricsError if not."""
    last = int(cloud.pair.max(initial=0))
    if last >= truths:
        raise MetricsError(
            f"the cloud has points of pair {last} (counted from 0), but the truth has only {counted(truths, 'pair')}: "
            "give the source that the cloud was made from"
        )
    stamps = cloud.pair_stamps_ns
    if stamps is not None and len(cloud) and last >= len(stamps):
        raise MetricsError(
            f"the cloud has points of pair {last} (counted from 0), but stamps for only "
            f"{counted(len(stamps), 'pair')}: give one stamp for each pair"
        )


def errors_of_pair(cloud: PointCloud, truth: PairTruth, number: int) -> PointErrors:
    """Return the errors of the points of one pair; MetricsError if a pixel is outside the image of the truth."""
    index = np.flatnonzero(cloud.pair == number)
    if (cloud.u[index] >= truth.rig.width).any() or (cloud.v[index] >= truth.rig.height).any():
        problem = f"the cloud has pixels outside the image of pair {number}, {truth.rig.width} x {truth.rig.height} px"
        raise MetricsError(f"{problem}: give the source that the cloud was made from")
    true = truth.points[cloud.v[index], cloud.u[index]].astype(np.float64)
    known = np.isfinite(true).all(axis=1)
    index, true = index[known], true[known]
    estimated = cloud.xyz[index].astype(np.float64)
    ray = true - truth.T_lm_left.translation
    distance = np.linalg.norm(ray, axis=1)
    offset = estimated - true
    depth, true_depth = truth.depths_m(estimated), truth.depths_m(true)
    return PointErrors(
        index=index,
        error_m=formulas.point_error(estimated, true),
        range_m=distance,
        along_m=np.sum(offset * ray, axis=1) / np.where(distance > 0.0, distance, np.nan),
        vertical_m=offset[:, 2],
        horizontal_m=np.hypot(offset[:, 0], offset[:, 1]),
        disparity_px=other_formulas.disparity_error(truth.rig.fx, truth.rig.baseline_m, depth, true_depth),
    )


def points_table(cloud: PointCloud, truths: Sequence[PairTruth]) -> dict[str, NDArray[Any]]:
    """Return the pixel, estimated and true position, range, error and sigma of every point with a truth, as columns."""
    errors = point_errors(cloud, truths)
    rows = errors.index
    pair, u, v = cloud.pair[rows], cloud.u[rows], cloud.v[rows]
    true = np.empty((len(rows), 3))
    for number, truth in enumerate(truths):
        mine = pair == number
        true[mine] = truth.points[v[mine], u[mine]]
    table: dict[str, NDArray[Any]] = {"pair": pair, "u": u, "v": v, "range_m": errors.range_m}
    table |= {"error_m": errors.error_m, "sigma_m": cloud.sigma[rows].astype(np.float64)}
    for axis, values in zip("xyz", true.T, strict=True):
        table[f"true_{axis}_m"] = values
    for axis, values in zip("xyz", cloud.xyz[rows].astype(np.float64).T, strict=True):
        table[f"estimated_{axis}_m"] = values
    return table


def typical_pixel_offset(cloud: PointCloud, truths: Sequence[PairTruth]) -> float:
    """Return the median distance between the projections of points and the pixels that the cloud states, px.

    The distance of a point behind the camera is infinite. The result is 0 without points.
    """
    offsets = []
    for number, truth in enumerate(truths):
        mine = np.flatnonzero(cloud.pair == number)
        mine = mine[:: max(1, len(mine) // PIXEL_SAMPLES)]
        x, y, z = ((cloud.xyz[mine].astype(np.float64) - truth.T_lm_left.translation) @ truth.T_lm_left.rotation).T
        rig, is_seen = truth.rig, z > 0.0
        depth = np.where(is_seen, z, 1.0)
        across = rig.fx * x / depth + rig.cx - cloud.u[mine]
        down = rig.fy * y / depth + rig.cy - cloud.v[mine]
        offsets.append(np.where(is_seen, np.hypot(across, down), np.inf))
    known = np.concatenate(offsets) if offsets else np.zeros(0)
    return float(np.median(known)) if len(known) else 0.0
