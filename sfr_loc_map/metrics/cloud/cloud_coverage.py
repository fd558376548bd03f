"""How much of what could be seen is in the cloud.

Of a cloud of single pairs: of the left pixels whose truth lies in the range, the share that has a point. Of a fused
cloud: the share of those true points with a cloud point nearer than two pixel footprints, 2 Z / f.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.metrics.cloud.cloud_truth import PairTruth

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

FOOTPRINTS = 2.0
BATCH = 262144


def pixel_coverage(cloud: PointCloud, truths: Sequence[PairTruth]) -> list[Mask]:
    """Return for each pair which pixels `(H, W)` have a point."""
    covered = []
    for number, truth in enumerate(truths):
        image = np.zeros(truth.points.shape[:2], np.bool_)
        mine = cloud.pair == number
        image[cloud.v[mine], cloud.u[mine]] = True
        covered.append(image)
    return covered


def footprint_coverage(
    cloud: PointCloud, truths: Sequence[PairTruth], ranges: Sequence[FloatArray], farthest_m: float
) -> list[Mask]:
    """Return for each pair which true points `(H, W)` up to a range have a cloud point within two footprints."""
    from scipy.spatial import cKDTree  # slow to import, and a node seldom needs it

    tree = cKDTree(cloud.xyz.astype(np.float64), balanced_tree=False, compact_nodes=False) if len(cloud) else None
    covered = []
    for number, (truth, distance) in enumerate(zip(truths, ranges, strict=True)):
        image = np.zeros(distance.shape, np.bool_)
        radius = FOOTPRINTS * truth.depths_m(truth.points) / truth.rig.fx
        mine = np.flatnonzero(cloud.pair == number)
        v, u = cloud.v[mine], cloud.u[mine]
        own = np.sqrt(np.square(cloud.xyz[mine].astype(np.float64) - truth.points[v, u]).sum(axis=1))
        image[v[own < radius[v, u]], u[own < radius[v, u]]] = True  # spares most of the search
        rows, columns = np.nonzero((distance <= farthest_m) & ~image)
        if tree is not None:
            image[rows, columns] = _near(tree, truth.points[rows, columns].astype(np.float64), radius[rows, columns])
        covered.append(image)
    return covered


def _near(tree: cKDTree, points: FloatArray, radius: FloatArray) -> NDArray[np.bool_]:
    order = np.argsort(radius, kind="stable")
    near = np.zeros(len(points), np.bool_)
    for first in range(0, len(order), BATCH):
        batch = order[first : first + BATCH]
        distance, _ = tree.query(points[batch], distance_upper_bound=float(radius[batch[-1]]), workers=-1)
        near[batch] = distance < radius[batch]
    return near
