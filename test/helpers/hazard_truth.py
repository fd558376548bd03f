"""Hazards of a map compared with the hazards of the true points."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.maps import FusedMap
from sfr_loc_map.mapping.terrain.terrain_grid import terrain_grid

REACH_M = 5.0
"""From the cameras; cells beyond are not compared."""


class HazardAccuracy(NamedTuple):
    """Counts of cells with a known truth and of their hazards; a hazard without points of the map is missed."""

    cells: int
    hazards: int
    precision: float
    recall: float


def hazard_accuracy(fused: FusedMap, truths: Sequence[np.ndarray]) -> HazardAccuracy:
    """Compare with the grid of all true points `(H, W, 3)` of the pairs, made by the same function."""
    config = TerrainConfig()
    points = [truth[np.isfinite(truth[..., 0])] for truth in truths]
    xyz = np.concatenate(points).astype(np.float32)
    pair = np.repeat(np.arange(len(points), dtype=np.uint8), [len(part) for part in points])
    zeros = np.zeros(len(xyz), np.uint16)
    cloud = PointCloud(xyz, np.full(len(xyz), 0.01, np.float32), zeros.astype(np.float32), zeros, zeros, pair)
    true = terrain_grid(cloud, config, fused.poses_lm_left)
    found = terrain_grid(fused.cloud, config, fused.poses_lm_left, fused.random_sigma)

    offset = np.subtract(found.elevation.origin_m, true.elevation.origin_m) / true.elevation.cell_m
    column, row = np.rint(offset).astype(int)
    hazard = np.full(true.hazard.shape, -1, np.int8)  # what is found in the cells of the true grid
    rows = np.arange(max(row, 0), min(row + found.hazard.shape[0], hazard.shape[0]))
    columns = np.arange(max(column, 0), min(column + found.hazard.shape[1], hazard.shape[1]))
    hazard[np.ix_(rows, columns)] = found.hazard[np.ix_(rows - row, columns - column)]

    centre = np.mean([pose.translation[:2] for pose in fused.poses_lm_left], axis=0)
    rows, columns = np.mgrid[: hazard.shape[0], : hazard.shape[1]] + 0.5
    x0, y0 = true.elevation.origin_m
    distance = np.hypot(columns * config.cell_m + x0 - centre[0], rows * config.cell_m + y0 - centre[1])
    compared = (distance <= REACH_M) & (true.hazard >= 0)
    is_found, is_true = (hazard == 100) & compared, (true.hazard == 100) & compared
    right = int((is_found & is_true).sum())
    precision, recall = right / max(is_found.sum(), 1), right / max(is_true.sum(), 1)
    return HazardAccuracy(int(compared.sum()), int(is_true.sum()), precision, recall)
