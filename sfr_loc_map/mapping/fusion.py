"""One cloud from up to three pairs.

Every point is looked up in the disparity pictures of the other pairs. Where both agree within their errors the point
moves along its own ray to the mean weighted by inverse variance, so that all pairs' points lie on one surface; where
another pair sees through it, the surer of the two stays. What a pair says counts less and less towards the border of
its picture, so that no seam shows where it ends.

Points are samples of the ground and all stay, each on the ray of its own pixel: where ground is seen at a grazing angle
the rows of one picture are centimetres apart, and those of another pair lie between them. Only of two points that are
one and the same sample the one that weighs more stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows

F = np.float32

AGREE_SIGMAS = 3.0
"""Differences up to so many standard deviations are taken as noise."""
FEATHER_PX = 48.0
"""Distance from the border of a picture from which on its points have full weight."""
JUMP_PX = F(1.0)
COMMON_SHARE = 0.5
"""Share of a point's variance that all pairs have in common (smoothing of the same shape) and no mean removes."""
SAMPLE = 4
"""Figures of the overlap are taken from every fourth point."""
LEAST_OVERLAP = 1000
"""Fewer points in common say nothing of poses."""
SAME_PX = F(0.02)
"""Two points that are seen nearer to each other than this are one sample: pictures from one place and direction."""
RANGE_WARNING = 1.8
"""Ratio of found to expected differences in range beyond which two pairs' poses are doubted."""
BESIDE_PX = 8
"""Grey levels are compared with those so far beside along both axes as well: what a wrong pose would show."""
GREY_WARNING = 0.45
"""Spread of grey level differences over that beside, beyond which poses are doubted; 0.1-0.3 where they are right."""
LEAST_TEXTURE = 2.0
"""Spread of grey level differences beside over that of noise, below which grey levels say nothing of poses."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One pair as the fusion sees it.

    Attributes:
        cloud: Its points in LM.
        disparity_px: `(H, W)` float32, pixels, NaN where none.
        T_lm_left: Takes points in its left optical frame to LM.
        noise_grey: Standard deviation of the difference of two pictures of the same ground, grey levels.
    """

    cloud: PointCloud
    disparity_px: FloatImage
    T_lm_left: Transform
    noise_grey: float


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """A fused cloud and how well its parts agreed."""

    cloud: PointCloud
    statistics: dict[str, float]
    warnings: tuple[str, ...]


def fused(views: Sequence[View], rig: StereoRig) -> Fusion:
    """Return one cloud of all pairs.

    Args:
        views: One per pair, in the order of their points' `pair`.
        rig: Rig of all pairs.
    """
    pictures = [(weight_picture(view), _grey_picture(view)) for view in views]
    statistics = {"points_in": float(sum(len(view.cloud) for view in views)), "merged": 0.0, "dropped_conflict": 0.0}
    warnings: list[str] = []
    clouds = []
    for i, view in enumerate(views):
        tally = _Tally(view, pictures[i][0])
        for j, other in enumerate(views):
            if j != i:
                seen = looked_up(view.cloud, other, *pictures[j], rig)
                ratios = tally.add(seen, before=j < i), _grey_ratio(seen, max(view.noise_grey, other.noise_grey))
                _describe(statistics, warnings, (i, j), seen, len(view.cloud), ratios)
        clouds.append(tally.cloud())
        statistics["merged"] += float((tally.partners > 0).sum())
        statistics["dropped_conflict"] += float(tally.conflict.sum())
    cloud = PointCloud.concatenate(clouds)
    statistics["points"] = float(len(cloud))
    return Fusion(cloud, statistics, tuple(warnings))


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What another pair says of the points that it sees too, all `(M,)`; `index` numbers them.

    `offset_px` is how far from its own sample it sees the point, `grey_beside` the difference of grey level at a place
    `BESIDE_PX` away; both grey differences are NaN where it has no point.
    """

    index: NDArray[np.intp]
    difference: FloatImage
    deviation: FloatImage
    weight: FloatImage
    grey_difference: FloatImage
    grey_beside: FloatImage
    offset_px: FloatImage


class _Tally:
    """Points of one pair and what the others say of them."""

    def __init__(self, view: View, weight: FloatImage) -> None:
        self._view = view
        cloud = view.cloud
        self._own = weight[cloud.v, cloud.u]
        self._sum = self._own.copy()
        self._pull = np.zeros_like(self._own)
        self.partners = np.zeros(len(cloud), np.uint8)
        self.conflict = np.zeros(len(cloud), np.bool_)
        self._kept = np.ones(len(cloud), np.bool_)

    def add(self, seen: Seen, *, before: bool) -> float:
        """Take in what another pair says; return the ratio of found to expected disagreement (1 for honest sigmas)."""
        index, own = seen.index, self._own[seen.index]
        spread = np.sqrt(np.square(self._view.cloud.sigma[index]) + np.square(seen.deviation))
        normalised = np.abs(seen.difference) / spread
        agree = normalised <= AGREE_SIGMAS
        weight = np.where(agree, seen.weight, F(0.0))
        self._sum[index] += weight
        self._pull[index] += weight * seen.difference
        self.partners[index] += agree
        heavier = (seen.weight > own) | ((seen.weight == own) & before)
        self._kept[index] &= ~(agree & heavier & (seen.offset_px < SAME_PX))
        self.conflict[index] |= heavier & (seen.difference > AGREE_SIGMAS * spread)
        return float(np.median(normalised[::SAMPLE]) / 0.6745) if len(index) else float("nan")

    def cloud(self) -> PointCloud:
        """Return the points that this pair keeps, moved along their rays."""
        kept = self._kept & ~self.conflict
        cloud = self._view.cloud.select(kept)
        shared = np.flatnonzero(self.partners[kept])
        total = self._sum[kept][shared]
        rays = cloud.xyz[shared] - self._view.T_lm_left.translation.astype(F)
        step = self._pull[kept][shared] / total / np.sqrt(np.einsum("ij,ij->i", rays, rays))
        cloud.xyz[shared] += rays * step[:, None]
        together = COMMON_SHARE * np.square(cloud.sigma[shared]) + (1.0 - COMMON_SHARE) / total
        cloud.sigma[shared] = np.sqrt(together)
        return cloud


def _describe(
    statistics: dict[str, float],
    warnings: list[str],
    pairs: tuple[int, int],
    seen: Seen,
    points: int,
    ratios: tuple[float, float],
) -> None:
    i, j = pairs
    statistics[f"overlap_{i}_{j}"] = len(seen.index) / max(points, 1)
    if len(seen.index) == 0:
        return
    some = seen.difference[::SAMPLE]
    middle = float(np.median(some))
    statistics[f"difference_median_m_{i}_{j}"] = middle
    statistics[f"difference_spread_m_{i}_{j}"] = 1.4826 * float(np.median(np.abs(some - F(middle))))
    statistics[f"difference_over_sigma_{i}_{j}"] = ratios[0]
    statistics[f"grey_difference_over_beside_{i}_{j}"] = ratios[1]
    wrong = ratios[0] > RANGE_WARNING or ratios[1] > GREY_WARNING
    if i < j and wrong and len(seen.index) > LEAST_OVERLAP:
        warnings.append(
            f"pairs {i} and {j} disagree where they overlap: ranges differ by {ratios[0]:.1f} times what is expected, "
            f"grey levels by {ratios[1]:.2f} of what they differ at places {BESIDE_PX} pixels away: check the baseline "
            "and their poses, or have the poses fitted (refine_poses)"
        )


def _grey_picture(view: View) -> FloatImage:
    """Return the left picture where there are points, NaN elsewhere."""
    grey = np.full(view.disparity_px.shape, np.nan, F)
    grey[view.cloud.v, view.cloud.u] = view.cloud.intensity
    return grey


def weight_picture(view: View) -> FloatImage:
    """Return the weight of each pixel, `feather / sigma^2`, 1 / m^2; 0 where there is no point."""
    height, width = view.disparity_px.shape
    sigma = np.full((height, width), np.inf, F)
    sigma[view.cloud.v, view.cloud.u] = view.cloud.sigma
    y, x = np.arange(height, dtype=F), np.arange(width, dtype=F)
    edge_y, edge_x = np.minimum(y, height - 1 - y) + F(1.0), np.minimum(x, width - 1 - x) + F(1.0)
    feather = np.minimum(np.minimum(edge_y[:, None], edge_x[None]) / F(FEATHER_PX), F(1.0))
    return np.asarray(feather / np.square(sigma), F)


def _grey_ratio(seen: Seen, noise: float) -> float:
    """Return the spread of grey level differences over that at places beside: a wrong pan shows here on any texture.

    NaN where there is too little texture or overlap.
    """
    here, beside = (_spread(item[::SAMPLE]) for item in (seen.grey_difference, seen.grey_beside))
    return here / beside if beside > LEAST_TEXTURE * noise else float("nan")


def _spread(values: FloatImage) -> float:
    known = values[np.isfinite(values)]
    return 1.4826 * float(np.median(np.abs(known - np.median(known)))) if len(known) else float("nan")


def looked_up(cloud: PointCloud, other: View, weight: FloatImage, grey: FloatImage, rig: StereoRig) -> Seen:
    """Return what another pair says of the points that it sees too.

    Args:
        cloud: Points in LM.
        other: The pair that is asked.
        weight: `(H, W)`, as `weight_picture` gives it.
        grey: `(H, W)` its left picture, NaN where it has no point.
        rig: Rig of all pairs.
    """
    T_left_lm = other.T_lm_left.inverse()
    out = np.empty((6, len(cloud)), F)
    camera = np.array([rig.fx, rig.fy, rig.cx, rig.cy, rig.fx * rig.baseline_m])
    _look_up(cloud.xyz, T_left_lm.rotation, T_left_lm.translation, camera, other.disparity_px, weight, grey, out)
    index = np.flatnonzero(np.isfinite(out[0]))
    difference, deviation, weights, here, beside, offset = out[:, index]
    own = cloud.intensity[index]
    return Seen(index, difference, deviation, weights, here - own, beside - own, offset)


@jit_rows
def _look_up(
    xyz: FloatImage,
    rotation: FloatArray,
    translation: FloatArray,
    camera: FloatArray,
    disparity: FloatImage,
    weight: FloatImage,
    grey: FloatImage,
    out: FloatImage,
) -> None:
    """Fill `out` `(6, N)` with what another pair says of points `(N, 3)`; NaN in the first row where it says nothing.

    The rows: how much farther along its ray it sees each, its sigma and weight, its grey level there and beside, and
    the distance in pixels from its nearest sample.
    """
    rows, cols = disparity.shape
    fx, fy, cx, cy, scale = camera
    for n in prange(len(xyz)):
        for k in range(6):
            out[k, n] = F(np.nan)
        x0, y0, z0 = np.float64(xyz[n, 0]), np.float64(xyz[n, 1]), np.float64(xyz[n, 2])
        xl = rotation[0, 0] * x0 + rotation[0, 1] * y0 + rotation[0, 2] * z0 + translation[0]
        yl = rotation[1, 0] * x0 + rotation[1, 1] * y0 + rotation[1, 2] * z0 + translation[1]
        zl = rotation[2, 0] * x0 + rotation[2, 1] * y0 + rotation[2, 2] * z0 + translation[2]
        if zl < 1e-3:
            continue
        u, v = fx * xl / zl + cx, fy * yl / zl + cy
        if not (u >= 0 and v >= 0 and u < cols - 1 and v < rows - 1):
            continue
        j, i = int(u), int(v)
        s, t = u - j, v - i
        a, b, c, d = disparity[i, j], disparity[i, j + 1], disparity[i + 1, j], disparity[i + 1, j + 1]
        if not (max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) < JUMP_PX):
            continue
        between = (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * c + s * d)
        y, x = i + (1 if t > 0.5 else 0), j + (1 if s > 0.5 else 0)
        near = weight[y, x]
        if not (between > 0.0 and near > 0.0):
            continue
        length = np.sqrt(xl * xl + yl * yl + zl * zl) / zl
        out[0, n] = (scale / between - zl) * length
        out[1, n] = 1.0 / np.sqrt(near)
        out[2, n] = near
        above = (1 - s) * grey[i, j] + s * grey[i, j + 1]
        out[3, n] = (1 - t) * above + t * ((1 - s) * grey[i + 1, j] + s * grey[i + 1, j + 1])
        if y + BESIDE_PX < rows and x + BESIDE_PX < cols:
            out[4, n] = grey[y + BESIDE_PX, x + BESIDE_PX]
        out[5, n] = np.sqrt((v - y) * (v - y) + (u - x) * (u - x))
