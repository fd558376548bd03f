"""The triangles of the ground: tiles of different sizes meet without gaps."""

import numpy as np
import pytest

from sfr_loc_map.simulation.config import GroundConfig, ReliefConfig
from sfr_loc_map.simulation.ground_mesh import CELLS, FINEST_M, ground_mesh
from sfr_loc_map.simulation.terrain import Terrain


@pytest.mark.slow
def test_ground_has_no_cracks() -> None:
    """Every edge that only one triangle has lies on an edge of the neighbouring tile, or at the rim of the world."""
    terrain = Terrain.make(3, ReliefConfig(), GroundConfig())
    mesh = ground_mesh(terrain, np.array([[0.0, 0.0], [2.0, 1.0]]))
    steps = np.rint((mesh.vertices[:, :2] - mesh.vertices[:, :2].min(axis=0)) / FINEST_M).astype(np.uint64)
    height_bits = np.ascontiguousarray(mesh.vertices[:, 2]).view(np.uint32).astype(np.uint64)
    columns = np.unique(steps[:, 0] * 65537 + steps[:, 1], return_inverse=True)[1].astype(np.uint64)
    keys = np.unique((columns << 32) + height_bits, return_inverse=True)[1]
    edges = np.sort(keys[mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)], axis=1)
    _unique, first, counts = np.unique(edges[:, 0] * len(keys) + edges[:, 1], return_index=True, return_counts=True)
    ends = mesh.vertices[mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1)].reshape(-1, 2, 3)[first[counts == 1]]
    rim = np.abs(ends[..., :2] - ends[..., :2].mean(axis=(0, 1))).max(axis=(1, 2)) > 500
    middle, length = ends.mean(axis=1)[~rim], np.abs(ends[:, 0] - ends[:, 1])[~rim, :2].max(axis=1)
    assert len(middle) > CELLS  # tiles of different size meet
    assert length.max() > length.min()
    finest = length == length.min()
    others = ends[~rim][~finest]
    for (a, b), x in zip(ends[~rim][finest][:200], middle[finest][:200], strict=True):
        axis = 0 if a[0] == b[0] else 1  # the edges of coarser tiles on the same line that cover it
        beside = (others[:, :, axis] == a[axis]).all(axis=1)
        low, high = others[..., 1 - axis].min(axis=1), others[..., 1 - axis].max(axis=1)
        for c, d in others[beside & (low <= x[1 - axis]) & (x[1 - axis] <= high)]:
            share = (np.array([a, b])[:, 1 - axis] - c[1 - axis]) / (d[1 - axis] - c[1 - axis])
            assert np.allclose(c[2] + share * (d[2] - c[2]), (a[2], b[2]), atol=2e-5)
