"""Point clouds with the pixel of each point.

`PointCloud` is part of the Python API. The methods `load` and `save` import the file formats when they are called,
because files belong to a higher layer.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.display import Shown, data_frame
from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray32, Mask

if TYPE_CHECKING:
    import pandas

    from sfr_loc_map.metrics.records import MethodRecord
    from sfr_loc_map.runs.calls import CallRecord

FIELD_TYPES: dict[str, type[np.generic]] = {
    **dict.fromkeys(("x", "y", "z", "sigma", "intensity"), np.float32),
    **{"u": np.uint16, "v": np.uint16, "pair": np.uint8},
}
"""Fields of a point, in the order of the topic `mapping/points` and of the cloud files."""
COLUMNS = ("xyz", "sigma", "intensity", "u", "v", "pair")  #: Arrays of a `PointCloud`, one row per point.


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PointCloud(Shown):
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
    records: tuple[CallRecord, ...] = ()  #: The calls that produced the points; empty if unknown.
    method: MethodRecord | None = None  #: The method that produced the points; None if unknown.

    def __post_init__(self) -> None:
        """Check shapes and types."""
        count = len(self.xyz)
        for name in COLUMNS:
            array = getattr(self, name)
            kind = FIELD_TYPES.get(name, np.float32)
            shape = (count, 3) if name == "xyz" else (count,)
            if array.shape != shape or array.dtype != kind:
                found = f"{array.dtype} {array.shape}"
                raise GeometryError(f"cloud field '{name}' is {found}: {kind.__name__} {shape} is required")

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
        """Return one cloud with the points of all clouds; `fused` and the stamps are kept if all clouds have the same.

        Records and method belong to single clouds and are dropped.
        """
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

    @staticmethod
    def load(path: str | os.PathLike[str]) -> PointCloud:
        """Read a cloud file of the suite: .ply, .pcd or .npz."""
        from sfr_loc_map.io.clouds.cloud_file import load_cloud

        found = load_cloud(Path(path)).cloud
        if found is None:
            raise InputError(f"'{path}' has points without pixels (u, v, pair): give the path itself to sfr.score")
        return found

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the cloud: .ply, .pcd or .npz."""
        from sfr_loc_map.io.clouds.cloud_file import save_cloud

        save_cloud(Path(path), self)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas DataFrame with one row per point."""
        structured = self.to_structured()
        return data_frame({name: structured[name] for name in FIELD_TYPES})

    def _facts(self) -> dict[str, str]:
        facts = {"points": f"{len(self)} points"}
        if len(self):
            sides = self.xyz.max(axis=0) - self.xyz.min(axis=0)
            facts["extent"] = " x ".join(f"{side:.1f}" for side in sides.tolist()) + " m"
            facts["sigma"] = f"median sigma {np.median(self.sigma):.2g} m"
        if self.fused is not None:
            facts["fused"] = "fused" if self.fused else "not fused"
        return facts
