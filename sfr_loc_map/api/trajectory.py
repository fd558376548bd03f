"""Trajectories with their files, as `sfr.localise` gives them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from sfr_loc_map.api.notebook import facts_html
from sfr_loc_map.api.paths import PathLike
from sfr_loc_map.api.pose_files import PoseFiles
from sfr_loc_map.api.tables import data_frame
from sfr_loc_map.config import build
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry import trajectory as base
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.metrics.score import MethodRecord
from sfr_loc_map.pipeline.call_stats import CallRecord, save_stats
from sfr_loc_map.pipeline.scoring import save_evo_result
from sfr_loc_map.report.path_figure import curves_of, path_figure

if TYPE_CHECKING:
    import pandas
    from plotly.graph_objects import Figure

COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Trajectory(PoseFiles):
    """Poses of RB in DS at stamps: `stamps_ns` `(N,)`, `positions` `(N, 3)` m, `quats_xyzw` `(N, 4)` as in ROS.

    Iterating gives `(stamp_ns, pose)`.

    Attributes:
        records: The calls that gave the poses: time, memory, state, covariance; empty for poses from elsewhere.
        method: Whose poses these are, None where nobody has said so.
    """

    records: tuple[CallRecord, ...] = ()
    method: MethodRecord | None = None

    @classmethod
    def of(cls, poses: base.Trajectory, records: Iterable[CallRecord] = (), method: MethodRecord | None = None) -> Self:
        """Return poses with the calls that gave them."""
        return cls(poses.stamps_ns, poses.positions, poses.quats_xyzw, tuple(records), method)

    @classmethod
    def from_estimates(cls, estimates: Iterable[PoseEstimate]) -> Self:
        """Return the poses of estimates, as `sfr.localise(..., live=True)` and `sfr.Localiser` give them."""
        return cls.from_poses((item.stamp_ns, item.T_ds_rb) for item in estimates)

    def to_evo(self, path: PathLike, truth: base.Trajectory, align: str = "se3") -> None:
        """Write the APE of the positions as a result of evo (zip), for `evo_res`.

        Args:
            path: The zip file.
            truth: True poses.
            align: Alignment with the truth: `none`, `origin`, `se3`, `sim3`.

        Raises:
            MetricsError: If no stamps are near those of the truth.
            OutputError: If it cannot be written.
        """
        config = build(AlignedErrorConfig, {"align": align}, origin="align")
        save_evo_result(Path(path), self, truth, config, {"est_name": "estimate", "ref_name": "truth"})

    def to_stats(self, path: PathLike) -> None:
        """Write one row a call (time, memory, state, covariance) as `sfr localise --stats` does.

        Raises:
            ConfigError: If the poses come from elsewhere, so that there are no calls.
            OutputError: If it cannot be written.
        """
        if not self.records:
            raise ConfigError("these poses have no calls: to_stats() is for what sfr.localise gives")
        save_stats(Path(path), list(self.records), self.method)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas table: one row a pose, indexed by `stamp_ns`; of our own poses with `state` and `reason`.

        Raises:
            MissingExtraError: If pandas is not installed.
        """
        frame = data_frame(dict(zip(COLUMNS, self._columns(), strict=True)))
        frame.index = self.stamps_ns
        frame.index.name = "stamp_ns"
        if self.records:
            frame["state"] = [record.state for record in self.records]
            frame["reason"] = [record.reason for record in self.records]
        return frame

    def plot(self, truth: base.Trajectory | None = None, align: str = "none") -> Figure:
        """Return the path as a plotly figure, as `sfr plot` draws it.

        Args:
            truth: True poses; then also the distance to them.
            align: Alignment with the truth: `none`, `origin`, `se3`, `sim3`.

        Raises:
            MetricsError: If no stamps are near those of the truth.
        """
        config = build(AlignedErrorConfig, {"align": align}, origin="align")
        return path_figure(curves_of({"estimate": self}, truth, config))

    def _columns(self) -> FloatArray:
        return np.hstack((self.positions, self.quats_xyzw)).T

    def __iter__(self) -> Iterator[tuple[int, Transform]]:
        """Yield stamp (ns) and pose `T_ds_rb` of each pose."""
        for index, stamp_ns in enumerate(self.stamps_ns.tolist()):
            yield stamp_ns, self.pose(index)

    @property
    def length_m(self) -> float:
        """Length of the path, m."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    @property
    def duration_s(self) -> float:
        """Time from the earliest to the latest pose, s."""
        return float(np.ptp(self.stamps_ns)) / NS_PER_S if len(self) else 0.0

    @property
    def states(self) -> dict[str, int]:
        """Number of poses by the state of the call; empty for poses from elsewhere."""
        return dict(Counter(record.state for record in self.records))

    def __repr__(self) -> str:
        """Return how many poses, how long, and what is wrong with them."""
        return f"Trajectory({', '.join(self._facts().values())})"

    def _repr_html_(self) -> str:
        return facts_html("Trajectory", self._facts())

    def _facts(self) -> dict[str, str]:
        facts = {
            "poses": f"{len(self)} poses",
            "duration": f"{self.duration_s:.1f} s",
            "path": f"{self.length_m:.2f} m",
        }
        if self.records:
            facts["states"] = ", ".join(f"{count} {state}" for state, count in self.states.items())
        return facts
