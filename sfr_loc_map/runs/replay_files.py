"""The files of a replay."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.atomic import write_text
from sfr_loc_map.io.clouds.cloud_file import save_cloud, save_points
from sfr_loc_map.io.tables.trajectory_file import save_trajectory
from sfr_loc_map.runs.call_files import save_stats
from sfr_loc_map.runs.replay_result import ReplayResult


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


def save_replay(result: ReplayResult, files: ReplayFiles) -> None:
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
