"""Accuracy of disparities over the true pixels that both images see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from sfr_loc_map.bench.figures import JsonObject
from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.metrics.config import MapScoreConfig
from sfr_loc_map.metrics.statistics import sample_statistic

OCCLUSION_PX = 1.0
"""A pixel is occluded in the right image where a surface nearer by more than this disparity covers its partner."""
MAD_TO_SIGMA = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of a normal distribution."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueDisparity:
    """Ground truth of one pair.

    Attributes:
        disparity_px: `(H, W)` float64, NaN where none.
        visible: `(H, W)` whether both images see it.
    """

    disparity_px: FloatArray
    visible: Mask

    @classmethod
    def of(cls, disparity_px: FloatArray) -> TrueDisparity:
        """Return the ground truth with the mask of what both images see."""
        return cls(disparity_px, visible_in_both(disparity_px))


def visible_in_both(disparity_px: FloatArray) -> Mask:
    """Return the mask of the pixels of the left image that the right one sees too, from true disparities `(H, W)`.

    The partner must lie within the right image, and no surface may lie in front of it: each pixel covers the two
    columns of the right image next to its partner.
    """
    height, width = disparity_px.shape
    rows, columns = np.nonzero(np.isfinite(disparity_px) & (disparity_px > 0))
    disparity = disparity_px[rows, columns]
    partner = columns - disparity
    inside = (partner >= 0) & (partner <= width - 1)
    rows, columns, disparity, partner = rows[inside], columns[inside], disparity[inside], partner[inside]
    nearest = np.zeros((height, width + 1))
    whole = np.floor(partner).astype(np.intp)
    np.maximum.at(nearest, (rows, whole), disparity)
    np.maximum.at(nearest, (rows, whole + 1), disparity)
    front = nearest[rows, np.rint(partner).astype(np.intp)] <= disparity + OCCLUSION_PX
    visible = np.zeros((height, width), np.bool_)
    visible[rows[front], columns[front]] = True
    return visible


@dataclass(frozen=True, slots=True)
class DisparityErrors:
    """Errors of disparities, pixels.

    Attributes:
        bad_1: Share that is wrong by more than 1 pixel.
        bad_2: Share that is wrong by more than 2 pixels.
        mean_abs_px: Mean absolute error.
        bias_px: Median error.
        sigma_px: 1.4826 times the median absolute deviation.
    """

    bad_1: float
    bad_2: float
    mean_abs_px: float
    bias_px: float
    sigma_px: float

    @classmethod
    def of(cls, error_px: FloatArray) -> DisparityErrors:
        """Return the figures of errors `(N,)`, N > 0."""
        size, bias = np.abs(error_px), float(np.median(error_px))
        sigma = MAD_TO_SIGMA * float(np.median(np.abs(error_px - bias)))
        return cls(float(np.mean(size > 1.0)), float(np.mean(size > 2.0)), float(size.mean()), bias, sigma)


@dataclass(frozen=True, slots=True)
class RangeErrors:
    """Errors of the points of one interval of range, metres [4.3.4].

    Attributes:
        count: Number of points.
        mean: Mean error.
        mean_plus_3sigma: Mean + 3 sigma of the error.
    """

    count: float
    mean: float | None
    mean_plus_3sigma: float | None


@dataclass(frozen=True, slots=True)
class DisparityAccuracy:
    """Accuracy of the disparities of some pairs.

    Attributes:
        density: Share of the true pixels seen by both images that have a disparity; None if there are none.
        errors: Errors over these pixels; None if there are none.
        coverage: Share of all true pixels within the range of the map score that have a disparity.
        by_range_m: Errors of points by interval of their true distance from the left camera, "from-to m".
    """

    density: float | None
    errors: DisparityErrors | None
    coverage: float | None
    by_range_m: dict[str, RangeErrors]

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        errors = {} if self.errors is None else asdict(self.errors)
        by_range = {name: asdict(item) for name, item in self.by_range_m.items()}
        return {"density": self.density, **errors, "coverage": self.coverage, "by_range_m": by_range}


def disparity_accuracy(
    found: Sequence[FloatImage], truths: Sequence[TrueDisparity], rig: StereoRig
) -> DisparityAccuracy:
    """Return the accuracy of the disparities of some pairs.

    A point lies on its pixel's ray, so its error is the difference of the distances along that ray.

    Args:
        found: `(H, W)` of each pair, pixels, NaN where none.
        truths: Their ground truth.
        rig: Their rig.
    """
    error = np.concatenate([(d - t.disparity_px)[t.visible] for d, t in zip(found, truths, strict=True)])
    total = len(error)
    error = error[np.isfinite(error)]
    coverage, by_range = _points(found, truths, rig)
    density = len(error) / total if total else None
    return DisparityAccuracy(density, DisparityErrors.of(error) if len(error) else None, coverage, by_range)


def _points(
    found: Sequence[FloatImage], truths: Sequence[TrueDisparity], rig: StereoRig
) -> tuple[float | None, dict[str, RangeErrors]]:
    """Return coverage, and the errors of points by range."""
    config = MapScoreConfig()
    u, v = np.meshgrid(np.arange(rig.width), np.arange(rig.height))
    ray = np.sqrt(((u - rig.cx) / rig.fx) ** 2 + ((v - rig.cy) / rig.fy) ** 2 + 1.0)
    scale = rig.fx * rig.baseline_m * ray
    with np.errstate(divide="ignore", invalid="ignore"):
        true = np.stack([scale / truth.disparity_px for truth in truths])
        error = np.abs(np.stack([scale / np.where(d > 0, d, np.nan) for d in found]) - true)
    has = np.isfinite(error)
    scored = (true >= config.scored_from_m) & (true < config.scored_to_m)
    by_range = {}
    for low, high in zip(config.range_edges_m, config.range_edges_m[1:], strict=False):
        points = sample_statistic(error[(true >= low) & (true < high) & has])
        by_range[f"{low:g}-{high:g} m"] = RangeErrors(points.count, points.mean, points.mean_plus_3sigma)
    return (float(np.mean(has[scored])) if scored.any() else None), by_range
