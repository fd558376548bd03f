"""Array types of all packages, their names in messages, read-only views, and functions for small arrays.

The functions for small arrays are faster than those of numpy.

The name of a type describes the content of an array. Shape and unit are given where the array is used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfr_loc_map.errors import GeometryError

FloatArray = NDArray[np.float64]  #: Values, vectors, matrices, poses; float64.
IntArray = NDArray[np.int64]  #: Stamps in nanoseconds, indices, counts; int64.
Mask = NDArray[np.bool_]  #: Boolean mask.
GreyImage = NDArray[np.uint8]  #: Image `(H, W)`, 8 bits.
ColourImage = NDArray[np.uint8]  #: Image `(H, W, 3)`, 8 bits per channel.
FloatImage = NDArray[np.float32]  #: Image `(H, W)` of float32: intensity, disparity, weight.
PointImage = NDArray[np.float32]  #: Points `(H, W, 3)` of the pixels of an image, metres; NaN where unknown.
FloatArray32 = NDArray[np.float32]  #: Values other than images in float32, where memory matters.
T = TypeVar("T", bound=np.generic)  #: Type of the elements of an array.
F = np.float32
"""Scalar type in image kernels: a constant `F(0.5)` keeps an expression in float32."""


def kind_of(value: object) -> str:
    """Return type and shape of an array, as in `float32 (3,)`, or the type of another object, for messages."""
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__


def check_numbers(**values: object) -> None:
    """Raise GeometryError unless every value is a real number. The keywords are the names in messages."""
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise GeometryError(f"{name} has the type {kind_of(value)}: a number is required")


def as_numbers(name: str, values: ArrayLike) -> FloatArray:
    """Return a copy of external values as float64; GeometryError with their name if they are not numbers."""
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise GeometryError(f"{name} is {values!r:.60}: numbers are required") from error


def read_only(array: NDArray[T]) -> NDArray[T]:
    """Return a read-only view of an array. The array itself stays writable, as the compiled kernels require."""
    view = array.view()
    view.setflags(write=False)
    return view


def length(vector: FloatArray) -> float:
    """Return the Euclidean norm of a vector `(N,)`, faster than `numpy.linalg.norm`."""
    return math.sqrt(vector.dot(vector))


def is_finite(*arrays: FloatArray) -> bool:
    """Return whether all numbers of some small arrays are finite, faster than `numpy.isfinite`."""
    return all(all(map(math.isfinite, array.ravel().tolist())) for array in arrays)


def diagonal_matrix(values: Sequence[float]) -> FloatArray:
    """Return the matrix `(N, N)` with N values on its diagonal, faster than `numpy.diag`."""
    matrix = np.zeros((len(values), len(values)))
    matrix.flat[:: len(values) + 1] = values
    return matrix


def outer_square(vector: FloatArray) -> FloatArray:
    """Return the product `v v^T` `(N, N)` of a vector `(N,)` with itself, faster than `numpy.outer`."""
    return vector[:, None] * vector


def median(values: NDArray[np.floating[Any]]) -> float:
    """Return the median of values without NaN, faster than `numpy.median`; NaN if there are no values."""
    count = values.size
    if count == 0:
        return float("nan")
    half = count // 2
    ordered = values.flatten()
    ordered.partition(half)
    if count % 2:
        return float(ordered[half])
    return float((ordered[:half].max() + ordered[half]) / 2.0)
