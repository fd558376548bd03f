"""Point clouds with their files, as `sfr.map` gives them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from sfr_loc_map.api.notebook import facts_html
from sfr_loc_map.api.paths import PathLike
from sfr_loc_map.api.tables import data_frame
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry import cloud as base
from sfr_loc_map.io.cloud_file import load_cloud, save_cloud
from sfr_loc_map.metrics.score import MethodRecord
from sfr_loc_map.pipeline.call_stats import CallRecord

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PointCloud(base.PointCloud):
    """Points in LM: `xyz` `(N, 3)` m, `sigma` `(N,)` m, `intensity`, and the pixel `u`, `v` and `pair` they come from.

    Attributes:
        records: The calls that gave the points: time, memory; empty for points from elsewhere.
        method: Whose points these are, None where nobody has said so.
    """

    records: tuple[CallRecord, ...] = ()
    method: MethodRecord | None = None

    @classmethod
    def of(
        cls, points: base.PointCloud, records: Iterable[CallRecord] = (), method: MethodRecord | None = None
    ) -> Self:
        """Return points with the calls that gave them."""
        columns = {name: getattr(points, name) for name in base.COLUMNS}
        return cls(
            **columns,
            fused=points.fused,
            pair_stamps_ns=points.pair_stamps_ns,
            records=tuple(records),
            method=method,
        )

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Read a cloud file of the suite: .ply, .pcd or .npz.

        Raises:
            InputError: If it cannot be read, or its points have no pixels; `sfr.score` takes the path of such a file.
        """
        loaded = load_cloud(Path(path))
        if loaded.cloud is None:
            raise InputError(f"'{path}' has points without pixels (u, v, pair): give the path itself to sfr.score")
        return cls.of(loaded.cloud)

    def save(self, path: PathLike) -> None:
        """Write the cloud: .ply, .pcd or .npz.

        Raises:
            OutputError: If it cannot be written.
        """
        save_cloud(Path(path), self)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas table: one row a point.

        Raises:
            MissingExtraError: If pandas is not installed.
        """
        records = self.to_structured()
        return data_frame({name: records[name] for name in base.FIELD_TYPES})

    def __repr__(self) -> str:
        """Return how many points there are, and where."""
        return f"PointCloud({', '.join(self._facts().values())})"

    def _repr_html_(self) -> str:
        return facts_html("PointCloud", self._facts())

    def _facts(self) -> dict[str, str]:
        facts = {"points": f"{len(self)} points"}
        if len(self):
            low, high = self.xyz.min(axis=0), self.xyz.max(axis=0)
            facts["extent"] = " x ".join(f"{side:.1f}" for side in (high - low).tolist()) + " m"
            facts["sigma"] = f"median sigma {np.median(self.sigma):.2g} m"
        if self.fused is not None:
            facts["fused"] = "fused" if self.fused else "not fused"
        return facts
