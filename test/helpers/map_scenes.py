"""Small scenes with known surfaces for tests of the map score."""

from typing import Any

import numpy as np

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.map.pair_truth import PairTruth

RIG = StereoRig(64, 48, 60.0, 60.0, 31.5, 23.5, 0.2)


def wall(distance_m: float = 5.0, shift_m: float = 0.0, rig: StereoRig = RIG) -> PairTruth:
    """A wall across the view, the camera shifted sideways along it; the upper quarter is sky."""
    T_lm_left = Transform(np.eye(3), np.array([shift_m, 0.0, 0.0]))
    u, v = np.meshgrid(np.arange(rig.width), np.arange(rig.height))
    points = np.stack(((u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy, np.ones(u.shape)), axis=-1) * distance_m
    points = (points + T_lm_left.translation).astype(np.float32)
    points[: rig.height // 4] = np.nan
    return PairTruth(points, T_lm_left, rig)


def points_of(xyz: Any, sigma: Any, u: Any, v: Any, pair: Any, fused: bool = False) -> PointCloud:
    """A cloud of points, one sigma or pair for all or one each."""
    count = len(xyz)
    columns = (sigma, np.float32), (0.0, np.float32), (u, np.uint16), (v, np.uint16), (pair, np.uint8)
    return PointCloud(
        xyz.astype(np.float32), *(np.broadcast_to(values, count).astype(kind) for values, kind in columns), fused
    )


def cloud_of(
    truths: list[PairTruth], stretch: float = 1.0, keep: float = 1.0, sigma: float = 0.05, fused: bool = False
) -> PointCloud:
    """All true points, their distance from the camera stretched; of each pair a share is kept."""
    rng = np.random.default_rng(1)
    clouds = []
    for number, truth in enumerate(truths):
        v, u = np.nonzero(np.isfinite(truth.points).all(axis=2) & (rng.random(truth.points.shape[:2]) < keep))
        centre = truth.T_lm_left.translation
        clouds.append(points_of((truth.points[v, u] - centre) * stretch + centre, sigma, u, v, number, fused))
    return PointCloud.concatenate(clouds)
