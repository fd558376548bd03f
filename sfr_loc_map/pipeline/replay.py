"""Score and files of a replay, from what the nodes answered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.cloud_file import LoadedCloud, save_cloud
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.trajectory_file import save_trajectory
from sfr_loc_map.metrics.cloud_truth import truths_of
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.resource_score import merge_parts, score_calls
from sfr_loc_map.metrics.results import build_score
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.call_stats import load_call_stats
from sfr_loc_map.pipeline.offline import save_stats
from sfr_loc_map.pipeline.scoring import (
    ScoreInputs,
    camera_place,
    load_estimates,
    provenance,
    score_cloud,
    warnings,
    with_conditions,
)


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResult:
    """What came out of a replay.

    Attributes:
        estimate: Estimated trajectory, without poses if there was no drive.
        cloud: Fused cloud, None if there was no mapping.
        records: All calls of localiser and mapper.
        monitor_report: Report of the monitor (JSON), empty if it gave none.
        mapped_ns: Stamps of the mapping pairs that were played: the cloud is judged by their truth.
    """

    estimate: Trajectory
    cloud: PointCloud | None
    records: Sequence[CallRecord]
    monitor_report: str
    mapped_ns: frozenset[int]


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
        """Fused cloud."""
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


def save_replay(result: ReplayResult, files: ReplayFiles) -> None:
    """Write trajectory, statistics, cloud and the monitor's report, as far as they are there.

    Raises:
        OutputError: If a file cannot be written.
    """
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
) -> dict[str, Any]:
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
    config = with_conditions(config, limits)
    stats = [load_call_stats(files.stats)] if result.records else []
    parts: list[dict[str, Any]] = [score_calls(item.calls) for item in stats]
    truth = source.loc.ground_truth if source.loc is not None else None
    has_trajectory = bool(len(result.estimate)) and truth is not None
    if has_trajectory and truth is not None:
        estimates = load_estimates(files.estimate, stats)
        parts.append(score_trajectory(estimates, truth, config.trajectory))
        parts.append(warnings(estimates.trajectory, truth, config, camera_place(source.path)))
    nav = source.nav.pairs() if source.nav is not None and result.cloud is not None else ()
    pairs = [pair for pair in nav if pair.pair.stamp_ns in result.mapped_ns]
    has_map = bool(pairs) and all(pair.truth is not None for pair in pairs)
    if has_map and source.nav is not None and result.cloud is not None:
        truths = truths_of(pairs, source.nav.rig)
        loaded = LoadedCloud(result.cloud.xyz.astype(np.float64), result.cloud)
        parts.append(score_cloud(loaded, truths, config, fused=len(pairs) > 1))
    inputs = ScoreInputs(
        estimate=files.estimate if has_trajectory else None,
        truth=source.path if has_trajectory else None,
        cloud=files.cloud if has_map else None,
        map_truth=source.path if has_map else None,
        stats=(files.stats,) if result.records else (),
    )
    return build_score(merge_parts(*parts), limits=limits, provenance=provenance(inputs, config))
