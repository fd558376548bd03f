"""Score and files of a replay, from what the nodes published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.cloud_file import LoadedCloud, save_cloud, save_points
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.trajectory_file import save_trajectory
from sfr_loc_map.methods.method import MethodTask
from sfr_loc_map.methods.registry import record_of_ours
from sfr_loc_map.metrics.cloud_error import truths_of
from sfr_loc_map.metrics.config import CallKind, ScoreConfig
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.pipeline.call_stats import CallRecord, CallStats, load_call_stats, save_stats
from sfr_loc_map.pipeline.external_run import Drive, ExternalRun, converted_run
from sfr_loc_map.pipeline.scoring import (
    Run,
    ScoredCloud,
    ScoredDrive,
    ScoreInputs,
    camera_rig,
    load_estimates,
    score_run,
)


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
        external: The external node, None without one; `finished` converts its poses.
        points: `(N, 3)` points in LM of an external mapper that tells no pixels, None otherwise.
    """

    estimate: Trajectory
    cloud: PointCloud | None
    records: Sequence[CallRecord]
    monitor_report: str
    mapped_ns: tuple[int, ...]
    cut_short: tuple[ReplayResult, ...] = ()
    external: ExternalRun | None = None
    points: FloatArray | None = None

    def finished(self, source: Source, config: ScoreConfig) -> ReplayResult:
        """Return it with the poses of an external localiser as poses of RB in DS; without one it stays as it is.

        Raises:
            ConfigError: If a frame is declared that the source does not tell.
            MetricsError: If the world frame cannot be aligned.
        """
        run, loc = self.external, source.loc
        if run is None or run.score.task != CallKind.LOCALISATION or loc is None:
            return self
        drive = Drive(loc.rig, loc.ground_truth)
        estimate, records, run = converted_run(self.estimate, self.records, run, drive, config)
        cut_short = tuple(item.finished(source, config) for item in self.cut_short)
        return replace(self, estimate=estimate, records=records, external=run, cut_short=cut_short)


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
    def points(self) -> Path:
        """The cloud of an external mapper that tells no pixels."""
        return self.folder / "cloud.npz"

    @property
    def as_published(self) -> Path:
        """Trajectory of an external node as it published it, before it was converted."""
        return self.folder / "estimate_as_published.csv"

    @property
    def external_log(self) -> Path:
        """What the process of an external node wrote."""
        return self.folder / "external.log"

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
        own = self.estimate, self.stats, self.cloud, self.monitor_report, self.report, self.page
        return (*own, self.points, self.as_published, self.external_log)

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
    if result.points is not None:
        save_points(files.points, result.points)
    if result.external is not None:
        _save_external(result.external, files)
    if result.monitor_report:
        with atomic_path(files.monitor_report) as temporary:
            temporary.write_text(result.monitor_report, encoding="utf-8")


def _save_external(run: ExternalRun, files: ReplayFiles) -> None:
    if run.as_published is not None:
        save_trajectory(files.as_published, run.as_published)
    if run.log:
        with atomic_path(files.external_log) as temporary:
            temporary.write_text(run.log, encoding="utf-8", errors="backslashreplace")


def score_replay(
    source: Source,
    result: ReplayResult,
    files: ReplayFiles,
    config: ScoreConfig,
    limits: Limits | None,
    settings: Mapping[str, object] = MappingProxyType({}),
) -> Score:
    """Return the score of what `save_replay` has written.

    Args:
        source: What was replayed.
        result: What came out.
        files: Where it was written.
        config: Settings.
        limits: Limits to judge by.
        settings: Of localiser and mapper, where they differ from the defaults; they join those of the score.

    Raises:
        SfrError: If a file cannot be read or the truth does not fit.
    """
    stats = [load_call_stats(files.stats)] if result.records else []
    drive, cloud = _drive(source, result, files, stats), _cloud(source, result)
    inputs = ScoreInputs(
        estimate=None if drive is None else files.estimate,
        truth=None if drive is None else source.path,
        cloud=None if cloud is None else files.cloud if result.points is None else files.points,
        map_truth=None if cloud is None else source.path,
        stats=(files.stats,) if stats else (),
    )
    task = MethodTask.MAP if drive is None else MethodTask.LOCALISE
    run = Run(inputs, stats, drive=drive, cloud=cloud, method=record_of_ours(task))
    if (node := result.external) is not None:
        run = replace(run, method=node.method, external=node.score, findings=node.findings, convention=node.convention)
    score = score_run(run, config, limits)
    made = score.provenance
    if made is None or not settings:
        return score
    return replace(score, provenance=replace(made, configuration={**made.configuration, **settings}))


def _drive(source: Source, result: ReplayResult, files: ReplayFiles, stats: Sequence[CallStats]) -> ScoredDrive | None:
    """Return the trajectory with its truth, None where one of both is not there."""
    truth = None if source.loc is None else source.loc.ground_truth
    if truth is None or not len(result.estimate):
        return None
    return ScoredDrive(load_estimates(files.estimate, stats), truth, camera_rig(source.path))


def _cloud(source: Source, result: ReplayResult) -> ScoredCloud | None:
    """Return the cloud with the truth of its pairs, None where one of both is not there."""
    xyz = result.points if result.cloud is None else result.cloud.xyz
    if source.nav is None or xyz is None:
        return None
    by_stamp = {pair.pair.stamp_ns: pair for pair in source.nav.pairs() if pair.pair.stamp_ns in result.mapped_ns}
    pairs = [by_stamp[stamp_ns] for stamp_ns in result.mapped_ns if stamp_ns in by_stamp]
    if not pairs or len(pairs) < len(result.mapped_ns) or any(pair.truth is None for pair in pairs):
        return None
    loaded = LoadedCloud(np.asarray(xyz, np.float64), result.cloud)
    return ScoredCloud(loaded, truths_of(pairs, source.nav.rig))
