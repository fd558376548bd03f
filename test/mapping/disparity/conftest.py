"""Dense forms of the regulariser, for small grids."""

from collections.abc import Callable

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.regularisation import SmoothnessWeights, fill_smoothness

F = np.float32


def dense_regulariser(weights: SmoothnessWeights) -> np.ndarray:
    """Return `A' W A` `(h w, h w)`, column by column."""
    shape = weights.along_x.shape
    columns = []
    for k in range(shape[0] * shape[1]):
        unit = np.zeros(shape, F)
        unit.flat[k] = 1.0
        product = np.empty(shape, F)
        fill_smoothness(unit, 0, weights, 0, product)
        columns.append(product.ravel())
    return np.stack(columns, axis=1).astype(np.float64)


def random_weights(shape: tuple[int, int], seed: int = 0) -> SmoothnessWeights:
    """Return weights from 0.5 to 2, 0 where a difference would reach beyond the border."""
    rng = np.random.default_rng(seed)
    along_x, along_y, mixed = (rng.uniform(0.5, 2.0, shape).astype(F) for _ in range(3))
    along_x[:, [0, -1]] = 0.0
    along_y[[0, -1]] = 0.0
    mixed[-1], mixed[:, -1] = 0.0, 0.0
    return SmoothnessWeights(along_x, along_y, mixed)


@pytest.fixture(scope="session")
def regulariser() -> Callable[[SmoothnessWeights], np.ndarray]:
    """The dense matrix of the regulariser."""
    return dense_regulariser


@pytest.fixture(scope="session")
def weights_of() -> Callable[..., SmoothnessWeights]:
    """Random weights for a shape."""
    return random_weights
