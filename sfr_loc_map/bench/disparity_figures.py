"""How good disparities are, over the truth that both pictures see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.bench.figures import Figures
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.metrics.config import MapScoreConfig
from sfr_loc_map.metrics.statistics import summary

HIDDEN_PX = 1.0
"""A pixel whose partner shows a surface nearer by more than this disparity is hidden from the right camera."""
MAD_TO_SIGMA = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of a normal law."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueDisparity:
    """The truth of one pair.

    Attributes:
        disparity_px: `(H, W)` float64, NaN where none.
        seen: `(H, W)` whether both pictures see it.
    """

    disparity_px: FloatArray
    seen: NDArray[np.bool_]

    @classmethod
    def of(cls, disparity_px: FloatArray) -> TrueDisparity:
        """Return the truth with what both pictures see."""
        return cls(disparity_px, seen_by_both(disparity_px))


def seen_by_both(disparity_px: FloatArray) -> NDArray[np.bool_]:
    """Tell which pixels of the left picture the right one sees as well, by their true disparities `(H, W)`.

    The partner must lie within the right picture, and no surface may lie in front of it: each pixel covers the two
    columns of the right picture next to its partner.
    """
    height, width = disparity_px.shape
    rows, columns = np.nonzero(np.isfinite(disparity_px) & (disparity_px > 0))
    disparity = disparity_px[rows, columns]
    place = columns - disparity
    inside = (place >= 0) & (place <= width - 1)
    rows, columns, disparity, place = rows[inside], columns[inside], disparity[inside], place[inside]
    nearest = np.zeros((height, width + 1))
    whole = np.floor(place).astype(np.intp)
    np.maximum.at(nearest, (rows, whole), disparity)
    np.maximum.at(nearest, (rows, whole + 1), disparity)
    front = nearest[rows, np.rint(place).astype(np.intp)] <= disparity + HIDDEN_PX
    seen = np.zeros((height, width), np.bool_)
    seen[rows[front], columns[front]] = True
    return seen


def disparity_figures(found: Sequence[NDArray[np.float32]], truths: Sequence[TrueDisparity], rig: StereoRig) -> Figures:
    """Return the figures of the disparities of some pairs.

    - `density`: share of the truth seen by both that has a disparity; the other figures are over these pixels.
    - `bad_1`, `bad_2`: share that is wrong by more than 1 and 2 pixels.
    - `mean_abs_px`; `bias_px`: median error; `sigma_px`: 1.4826 times the median distance from it.
    - `coverage`: share of all truth within the range of the suite's map score that has a disparity, seen twice or not.
    - `by_range`: error of the points [4.3.4] whose truth is seen from the left camera at these distances. A point lies
      on its pixel's ray, so it is off by the difference of the depths along it.

    Args:
        found: `(H, W)` of each pair, pixels, NaN where none.
        truths: Their truth.
        rig: Their rig.
    """
    error = np.concatenate([(d - t.disparity_px)[t.seen] for d, t in zip(found, truths, strict=True)])
    total = len(error)
    error = error[np.isfinite(error)]
    figures: Figures = {"density": len(error) / total if total else None}
    if len(error):
        size, bias = np.abs(error), float(np.median(error))
        figures |= {
            "bad_1": float(np.mean(size > 1.0)),
            "bad_2": float(np.mean(size > 2.0)),
            "mean_abs_px": float(size.mean()),
            "bias_px": bias,
            "sigma_px": MAD_TO_SIGMA * float(np.median(np.abs(error - bias))),
        }
    return figures | _points(found, truths, rig)


def _points(found: Sequence[NDArray[np.float32]], truths: Sequence[TrueDisparity], rig: StereoRig) -> Figures:
    config = MapScoreConfig()
    u, v = np.meshgrid(np.arange(rig.width), np.arange(rig.height))
    ray = np.sqrt(((u - rig.cx) / rig.fx) ** 2 + ((v - rig.cy) / rig.fy) ** 2 + 1.0)
    scale = rig.fx * rig.baseline_m * ray
    with np.errstate(divide="ignore", invalid="ignore"):
        true = np.stack([scale / truth.disparity_px for truth in truths])
        error = np.abs(np.stack([scale / np.where(d > 0, d, np.nan) for d in found]) - true)
    has = np.isfinite(error)
    scored = (true >= config.scored_from_m) & (true < config.scored_to_m)
    by_range: Figures = {}
    for low, high in zip(config.range_edges_m, config.range_edges_m[1:], strict=False):
        inside = (true >= low) & (true < high)
        points = summary(error[inside & has])
        by_range[f"{low:g}-{high:g} m"] = {name: points[name] for name in ("count", "mean", "mean_plus_3sigma")}
    covered = float(np.mean(has[scored])) if scored.any() else None
    return {"coverage": covered, "by_range_m": by_range}
