"""Corrections of matrices that must be symmetric, such as covariances."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray


def symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix."""
    return np.asarray(0.5 * (matrix + matrix.T))


def positive_part(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix without its negative eigenvalues."""
    values, vectors = np.linalg.eigh(symmetric(matrix))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
