"""Point clouds with the pixel of each point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray32, Mask, kind_of

FIELD_TYPES: dict[str, type[np.generic]] = {
    **dict.fromkeys(("x", "y", "z", "sigma", "intensity"), np.float32),
    **{"u": np.uint16, "v": np.uint16, "pair": np.uint8},
}
"""Fields of a point, in the order of the topic `mapping/points` and of the cloud files."""
COLUMNS = ("xyz", "sigma", "intensity", "u", "v", "pair")  #: Arrays of a `PointCloud`, one row per point.


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points in LM, each with its pixel and stereo pair; one row per point.

    `fused` is True if several pairs were fused into one surface, and False if the cloud keeps the points of each pair.
    `fused` and the stamps of the pairs are None if unknown.
    """

    xyz: FloatArray32  #: `(N, 3)`, metres, LM.
    #: Standard deviation along the ray, metres. `mapping.point_sigma` lists its components.
    sigma: FloatArray32
    intensity: FloatArray32  #: Grey level of the left pixel.
    u: NDArray[np.uint16]  #: Column of the left pixel.
    v: NDArray[np.uint16]  #: Row of the left pixel.
    pair: NDArray[np.uint8]  #: Index of the stereo pair within its set (0, 1, 2).
    fused: bool | None = None
    pair_stamps_ns: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        """Check shapes and types; GeometryError if a field is not an array of its shape and type."""
        count = np.size(self.xyz) // 3
        for name in COLUMNS:
            array = getattr(self, name)
            kind = FIELD_TYPES.get(name, np.float32)
            shape = (count, 3) if name == "xyz" else (count,)
            if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != kind:
                raise GeometryError(f"cloud field '{name}' is {kind_of(array)}: {kind.__name__} {shape} is required")

    def __len__(self) -> int:
        return len(self.xyz)

    @classmethod
    def empty(cls, fused: bool | None = None) -> PointCloud:
        """Return a cloud without points."""
        return cls.from_structured(np.zeros(0, cls.dtype()), fused)

    @staticmethod
    def dtype() -> np.dtype[np.void]:
        """Return the packed record type of a point, in the order of `FIELD_TYPES`."""
        return np.dtype(list(FIELD_TYPES.items()))

    def to_structured(self) -> NDArray[np.void]:
        """Return the points as packed records `(N,)` of `dtype()`."""
        records = np.empty(len(self), self.dtype())
        for axis, name in enumerate("xyz"):
            records[name] = self.xyz[:, axis]
        for name in COLUMNS[1:]:
            records[name] = getattr(self, name)
        return records

    @classmethod
    def from_structured(
        cls, records: NDArray[np.void], fused: bool | None = None, pair_stamps_ns: tuple[int, ...] | None = None
    ) -> PointCloud:
        """Return the cloud of records that have the fields of `FIELD_TYPES`, in any order and layout."""
        xyz = np.empty((len(records), 3), np.float32)
        for axis, name in enumerate("xyz"):
            xyz[:, axis] = records[name]
        rest: dict[str, Any] = {name: np.ascontiguousarray(records[name], FIELD_TYPES[name]) for name in COLUMNS[1:]}
        return cls(xyz, **rest, fused=fused, pair_stamps_ns=pair_stamps_ns)

    def select(self, which: Mask | NDArray[np.intp]) -> PointCloud:
        """Return the points that a mask `(N,)` or row indices select."""
        rows = np.flatnonzero(which) if which.dtype == np.bool_ else which  # a mask would be searched once per column
        return replace(self, **{name: getattr(self, name).take(rows, axis=0) for name in COLUMNS})

    @classmethod
    def concatenate(cls, clouds: Sequence[PointCloud]) -> PointCloud:
        """Return the points of all clouds; `fused` and the stamps are kept if they are equal in all clouds."""
        if not clouds:
            return cls.empty()
        fused = {cloud.fused for cloud in clouds}
        stamps = {cloud.pair_stamps_ns for cloud in clouds}
        columns: dict[str, Any] = {name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in COLUMNS}
        return cls(
            **columns,
            fused=fused.pop() if len(fused) == 1 else None,
            pair_stamps_ns=stamps.pop() if len(stamps) == 1 else None,
        )
