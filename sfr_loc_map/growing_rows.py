"""An array of rows that are added one by one, such as the poses of a run in progress."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class GrowingRows:
    """Rows that are added one by one. Memory of unused rows is not resident."""

    def __init__(self, kind: DTypeLike) -> None:
        """Start without rows; `kind` is the structured type of a row."""
        self._array: NDArray[Any] = np.empty(1024, np.dtype(kind, align=True))
        self._count = 0

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._count

    def add(self, *row: object) -> None:
        """Add a row, given by its values in the order of the fields."""
        if self._count == len(self._array):
            longer = np.empty(2 * self._count, self._array.dtype)
            longer[: self._count] = self._array
            self._array = longer
        self._array[self._count] = row
        self._count += 1

    def all(self) -> NDArray[Any]:
        """Return a view that is valid until the next row is added."""
        return self._array[: self._count]
