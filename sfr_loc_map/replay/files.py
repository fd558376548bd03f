"""The files of a replay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sfr_loc_map.atomic import write_text
from sfr_loc_map.calls.call_files import save_stats
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.io.clouds.cloud_file import save_cloud, save_points
from sfr_loc_map.io.tables.trajectory_file import save_trajectory
from sfr_loc_map.metrics.table.records import CallFinding, MethodRecord
from sfr_loc_map.replay.result import ExternalResult, ReplayResult


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


def save_replay(result: ReplayResult, files: ReplayFiles, method: MethodRecord) -> None:
    """Write the available results of a replay, without the score. The calls name the method."""
    node = result.external
    if len(result.estimate):
        save_trajectory(files.estimate, result.estimate)
    if result.records:
        records = result.records if node is None else with_findings(result.records, node)
        save_stats(files.stats, records, method, result.estimate)
    if result.map.cloud is not None:
        save_cloud(files.cloud, result.map.cloud)
    if result.map.points is not None:
        save_points(files.points, result.map.points)
    if node is not None and node.as_published is not None:
        save_trajectory(files.as_published, node.as_published)
    if node is not None and node.log:
        write_text(node.log, files.external_log)


def with_findings(records: Sequence[CallRecord], node: ExternalResult) -> list[CallRecord]:
    """Return the calls of a replay with the findings on an external node, so that a score of the file has them.

    A finding is stated by the call of its task that is nearest to its first stamp and states no other finding, because
    a pair without an answer has no call. If there are more findings than calls, those that prevent a pass are stated.
    """
    found = [*records]
    of_task = [row for row, record in enumerate(records) if record.task == node.score.task]
    free = [row for row in of_task if not records[row].finding]
    for finding in sorted(node.findings, key=lambda finding: not finding.kind.fails)[: len(free)]:
        first_ns = finding.first_stamp_ns or 0
        row = min(free, key=lambda row: abs(records[row].stamp_ns - first_ns))
        free.remove(row)
        found[row] = replace(records[row], finding=str(CallFinding(finding.kind, finding.text)))
    return found
