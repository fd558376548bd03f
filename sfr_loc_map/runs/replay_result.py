"""The results of a replay, and their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.atomic import write_text
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import save_cloud, save_points
from sfr_loc_map.io.tables.trajectory_file import save_trajectory
from sfr_loc_map.metrics.records import ConventionRecord, ExternalScore, FindingRecord, MethodRecord
from sfr_loc_map.runs.calls import CallRecord, save_stats


@dataclass(frozen=True, slots=True, eq=False)
class ExternalRun:
    """The results about an external node in a replay."""

    method: MethodRecord
    score: ExternalScore  # how it behaved
    findings: tuple[FindingRecord, ...]  # errors in its answers
    log: str = ""  # output of its process; empty if the process was not started here
    convention: ConventionRecord | None = None  # conversion of its results
    as_published: Trajectory | None = None  # its poses as it published them


@dataclass(frozen=True, slots=True, eq=False)
class CollectedRun:
    """The results of a replay."""

    estimate: Trajectory  # empty without a drive
    cloud: PointCloud | None  # the last cloud
    records: Sequence[CallRecord]  # all calls of localiser and mapper
    mapped_ns: tuple[int, ...]  # stamps of the pairs of the cloud, in the order of the points' `pair`
    external: ExternalRun | None = None  # its poses are converted by `nodes.replay.external_poses`
    points: FloatArray | None = None  # `(N, 3)` in LM, of an external mapper without pixels


class ReplayFiles:
    """Paths of the outputs of a replay."""

    def __init__(self, folder: Path) -> None:
        """Set the paths; no file is accessed."""
        self.folder = folder
        self.estimate = folder / "estimate.csv"
        self.stats = folder / "stats.csv"  # one row for each call
        self.cloud = folder / "cloud.ply"
        self.report = folder / "report.json"
        self.page = folder / "report.html"
        self.points = folder / "cloud.npz"  # the cloud of an external mapper without pixels
        self.as_published = folder / "estimate_as_published.csv"  # poses of an external node before conversion
        self.external_log = folder / "external.log"

    @property
    def all(self) -> tuple[Path, ...]:
        """The paths of all outputs."""
        return tuple(path for name, path in vars(self).items() if name != "folder")

    def remove(self) -> None:
        """Remove the files of an earlier replay; other files are kept."""
        for path in self.all:
            path.unlink(missing_ok=True)


def save_replay(result: CollectedRun, files: ReplayFiles) -> None:
    """Write the available results of a replay, without the score."""
    if len(result.estimate):
        save_trajectory(files.estimate, result.estimate)
    if result.records:
        save_stats(files.stats, result.records, estimate=result.estimate)
    if result.cloud is not None:
        save_cloud(files.cloud, result.cloud)
    if result.points is not None:
        save_points(files.points, result.points)
    if result.external is not None and result.external.as_published is not None:
        save_trajectory(files.as_published, result.external.as_published)
    if result.external is not None and result.external.log:
        write_text(result.external.log, files.external_log)
