"""The files of a replay."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.atomic import write_text
from sfr_loc_map.calls.call_files import save_stats
from sfr_loc_map.io.clouds.cloud_file import save_cloud, save_points
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.replay.result import ReplayResult


class ReplayFiles:
    """Paths of the outputs of a replay. `save_replay` writes the results, and `cli.verdict` report and page."""

    def __init__(self, folder: Path) -> None:
        """Set the paths; no file is accessed."""
        self.folder = folder
        self.estimate = folder / "estimate.csv"
        self.as_published = folder / "estimate_as_published.csv"  # poses of an external node before conversion
        self.stats = folder / "stats.csv"  # one row for each call and for each finding on an external node
        self.cloud = folder / "cloud.ply"
        self.points = folder / "cloud.npz"  # the cloud of an external mapper without pixels
        self.external_log = folder / "external.log"
        self.report = folder / "report.json"
        self.page = folder / "report.html"

    @property
    def all(self) -> tuple[Path, ...]:
        """The paths of all outputs."""
        return (
            self.estimate,
            self.as_published,
            self.stats,
            self.cloud,
            self.points,
            self.external_log,
            self.report,
            self.page,
        )


def save_replay(result: ReplayResult, files: ReplayFiles) -> None:
    """Write the available results of a replay. The calls name the method of their task.

    The files of an earlier replay are removed first, because it may have written more files. Other files are kept.
    """
    for path in files.all:
        path.unlink(missing_ok=True)
    node = result.external
    if len(result.estimate):
        save_trajectory(files.estimate, result.estimate)
    if result.has_stats:
        findings = {} if node is None else {node.task: node.findings}
        save_stats(
            files.stats,
            result.records,
            result.methods,
            result.estimate,
            findings,
            cloud=result.map.cloud,
            replay_rate=result.rate,
        )
    if result.map.cloud is not None:
        save_cloud(files.cloud, result.map.cloud)
    if result.map.points is not None:
        save_points(files.points, result.map.points)
    if node is not None and node.as_published is not None:
        save_trajectory(files.as_published, node.as_published)
    if node is not None and node.log:
        write_text(node.log, files.external_log)
