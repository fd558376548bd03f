"""Images, clouds, grids and masks are small enough for a screen, and lose nothing that matters."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.live.media import MAX_CELLS, thinned
from sfr_loc_map.live.updates import ElevationSample


def test_thinned_grids_keep_the_worst_hazard_and_means_of_heights() -> None:
    layers = np.zeros((400, 300, 3), np.float32)
    layers[..., 0] = np.arange(400)[:, None]
    layers[7, 8, 1], layers[..., 2], layers[:4, :4, 0] = 100.0, 1.0, np.nan
    grid = thinned(ElevationSample("m", 0, (1.0, 2.0), 0.1, ("height", "hazard", "count"), layers, 0.0))
    assert grid.every == 2
    assert grid.layers.shape == (200, 150, 3)
    assert grid.layers.shape[0] * grid.layers.shape[1] <= MAX_CELLS
    assert grid.cell_m == pytest.approx(0.2)
    assert grid.layers[3, 4, 1] == 100.0
    assert (grid.layers[5, 5, 0], grid.layers[5, 5, 2]) == (10.5, 4.0)
    assert np.isnan(grid.layers[1, 1, 0])
