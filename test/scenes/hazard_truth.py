"""Hazards of a map against those of the ground truth's own points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.mapping.config import TerrainConfig
from sfr_loc_map.mapping.mapper import FusedMap
from sfr_loc_map.mapping.terrain.grid import TerrainGrid, elevation_grid

REACH_M = 5.0
"""From the cameras; cells beyond are not compared."""


@dataclass(frozen=True)
class HazardAccuracy:
    """Cells whose truth is known; a hazard where the map has no points is missed."""

    cells: int
    hazards: int
    found: int
    right: int

    @property
    def precision(self) -> float:
        return self.right / max(self.found, 1)

    @property
    def recall(self) -> float:
        return self.right / max(self.hazards, 1)


def hazard_accuracy(
    fused: FusedMap, truths: Sequence[np.ndarray], config: TerrainConfig | None = None
) -> HazardAccuracy:
    """Compare with the grid of all true points `(H, W, 3)` of the pairs, made by the same function."""
    config = config or TerrainConfig()
    found = elevation_grid(fused.cloud, config, fused.T_lm_left, fused.random_sigma)
    true = elevation_grid(_cloud_of(truths), config, fused.T_lm_left)
    hazard = _on_grid_of(true, found)
    centre = np.mean([pose.translation[:2] for pose in fused.T_lm_left], axis=0)
    rows, columns = np.mgrid[: hazard.shape[0], : hazard.shape[1]] + 0.5
    x0, y0 = true.elevation.origin_m
    distance = np.hypot(columns * config.cell_m + x0 - centre[0], rows * config.cell_m + y0 - centre[1])
    compared = (distance <= REACH_M) & (true.hazard >= 0)
    is_found, is_true = (hazard == 100) & compared, (true.hazard == 100) & compared
    return HazardAccuracy(*(int(mask.sum()) for mask in (compared, is_true, is_found, is_found & is_true)))


def _cloud_of(truths: Sequence[np.ndarray]) -> PointCloud:
    points = [truth[np.isfinite(truth[..., 0])] for truth in truths]
    xyz = np.concatenate(points).astype(np.float32)
    pair = np.repeat(np.arange(len(points), dtype=np.uint8), [len(part) for part in points])
    zeros = np.zeros(len(xyz), np.uint16)
    return PointCloud(xyz, np.full(len(xyz), 0.01, np.float32), zeros.astype(np.float32), zeros, zeros, pair)


def _on_grid_of(true: TerrainGrid, found: TerrainGrid) -> np.ndarray:
    """Return the hazards found in the cells of the true grid; -1 where there is none."""
    offset = np.subtract(found.elevation.origin_m, true.elevation.origin_m) / true.elevation.cell_m
    column, row = np.rint(offset).astype(int)
    hazard = np.full(true.hazard.shape, -1, np.int8)
    rows = np.arange(max(row, 0), min(row + found.hazard.shape[0], hazard.shape[0]))
    columns = np.arange(max(column, 0), min(column + found.hazard.shape[1], hazard.shape[1]))
    hazard[np.ix_(rows, columns)] = found.hazard[np.ix_(rows - row, columns - column)]
    return hazard
