"""Score and files of a replay, from what the nodes published."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.cloud_file import LoadedCloud, save_cloud
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.trajectory_file import save_trajectory
from sfr_loc_map.metrics.cloud.cloud_truth import truths_of
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.verdicts.limits import Limits
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.call_stats import CallStats, load_call_stats
from sfr_loc_map.pipeline.offline import save_stats
from sfr_loc_map.pipeline.score_inputs import ScoreInputs, camera_extrinsics, load_estimates
from sfr_loc_map.pipeline.scored_drive import ScoredDrive
from sfr_loc_map.pipeline.scoring import Run, ScoredCloud, score_run


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResult:
    """What came out of a replay.

    Attributes:
        estimate: Estimated trajectory, without poses if there was no drive.
        cloud: The last cloud, None if there was no mapping.
        records: All calls of localiser and mapper.
        monitor_report: Report of the monitor (JSON), empty if it gave none.
        mapped_ns: Stamps of the pairs of the cloud, in the order of the points' `pair`: it is judged by their truth.
        cut_short: Other runs, which a jump or a signal ended.
    """

    estimate: Trajectory
    cloud: PointCloud | None
    records: Sequence[CallRecord]
    monitor_report: str
    mapped_ns: tuple[int, ...]
    cut_short: tuple[ReplayResult, ...] = ()


@dataclass(frozen=True, slots=True)
class ReplayFiles:
    """Places of the outputs of a replay."""

    folder: Path

    @property
    def estimate(self) -> Path:
        """Estimated trajectory."""
        return self.folder / "estimate.csv"

    @property
    def stats(self) -> Path:
        """One row for each call."""
        return self.folder / "stats.csv"

    @property
    def cloud(self) -> Path:
        """The cloud."""
        return self.folder / "cloud.ply"

    @property
    def monitor_report(self) -> Path:
        """Report of the monitor node."""
        return self.folder / "monitor.json"

    @property
    def report(self) -> Path:
        """The score."""
        return self.folder / "report.json"

    @property
    def page(self) -> Path:
        """The score as a page."""
        return self.folder / "report.html"

    @property
    def all(self) -> tuple[Path, ...]:
        """All of them."""
        return self.estimate, self.stats, self.cloud, self.monitor_report, self.report, self.page

    def of_run(self, number: int) -> ReplayFiles:
        """Return the places of a run that was cut short, counted from 1."""
        return ReplayFiles(self.folder / f"run_{number}")


def save_replay(result: ReplayResult, files: ReplayFiles) -> None:
    """Write trajectory, statistics, cloud and the monitor's report, as far as they are there.

    Runs that were cut short come into folders beside them.

    Raises:
        OutputError: If a file cannot be written.
    """
    for number, run in enumerate(result.cut_short, 1):
        place = files.of_run(number)
        place.folder.mkdir(exist_ok=True)
        save_replay(run, place)
    if len(result.estimate):
        save_trajectory(files.estimate, result.estimate)
    if result.records:
        save_stats(files.stats, list(result.records))
    if result.cloud is not None:
        save_cloud(files.cloud, result.cloud)
    if result.monitor_report:
        with atomic_path(files.monitor_report) as temporary:
            temporary.write_text(result.monitor_report, encoding="utf-8")


def score_replay(
    source: Source, result: ReplayResult, files: ReplayFiles, config: ScoreConfig, limits: Limits | None
) -> Score:
    """Return the score of what `save_replay` has written.

    Args:
        source: What was replayed.
        result: What came out.
        files: Where it was written.
        config: Settings.
        limits: Limits to judge by.

    Raises:
        SfrError: If a file cannot be read or the truth does not fit.
    """
    stats = [load_call_stats(files.stats)] if result.records else []
    drive, cloud = _drive(source, result, files, stats), _cloud(source, result)
    inputs = ScoreInputs(
        estimate=None if drive is None else files.estimate,
        truth=None if drive is None else source.path,
        cloud=None if cloud is None else files.cloud,
        map_truth=None if cloud is None else source.path,
        stats=(files.stats,) if stats else (),
    )
    return score_run(Run(inputs, stats, drive=drive, cloud=cloud), config, limits)


def _drive(source: Source, result: ReplayResult, files: ReplayFiles, stats: Sequence[CallStats]) -> ScoredDrive | None:
    """Return the trajectory with its truth, None where one of both is not there."""
    truth = None if source.loc is None else source.loc.ground_truth
    if truth is None or not len(result.estimate):
        return None
    return ScoredDrive(load_estimates(files.estimate, stats), truth, camera_extrinsics(source.path))


def _cloud(source: Source, result: ReplayResult) -> ScoredCloud | None:
    """Return the cloud with the truth of its pairs, None where one of both is not there."""
    if source.nav is None or result.cloud is None:
        return None
    by_stamp = {pair.pair.stamp_ns: pair for pair in source.nav.pairs() if pair.pair.stamp_ns in result.mapped_ns}
    pairs = [by_stamp[stamp_ns] for stamp_ns in result.mapped_ns if stamp_ns in by_stamp]
    if not pairs or len(pairs) < len(result.mapped_ns) or any(pair.truth is None for pair in pairs):
        return None
    loaded = LoadedCloud(result.cloud.xyz.astype(np.float64), result.cloud)
    return ScoredCloud(loaded, truths_of(pairs, source.nav.rig))
