"""Score and files of a replay, from what the nodes published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from sfr_loc_map.atomic import write_text
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import Task, hash_arrays
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud, save_cloud, save_points
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_config import AS_IT_IS, source_config
from sfr_loc_map.io.tables.trajectory_file import save_trajectory
from sfr_loc_map.methods.registry import record_of_ours
from sfr_loc_map.metrics.cloud_error import truths_of
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.records import ConventionRecord, ExternalScore, FindingRecord, MethodRecord
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.runs.calls import CallRecord, save_stats, stats_of
from sfr_loc_map.scoring.load import estimates_of_calls, with_read_files
from sfr_loc_map.scoring.run import CloudToScore, DriveToScore, Run, ScoreInputs
from sfr_loc_map.scoring.score_run import score_run


@dataclass(frozen=True, slots=True, eq=False)
class ExternalRun:
    """What is known of an external node after a replay."""

    method: MethodRecord
    score: ExternalScore  # how it behaved
    findings: tuple[FindingRecord, ...]  # what was wrong with its answers
    log: str = ""  # what its process wrote; empty where it was not started here
    convention: ConventionRecord | None = None  # how its results have been converted
    as_published: Trajectory | None = None  # its poses as it published them


@dataclass(frozen=True, slots=True, eq=False)
class CollectedRun:
    """What came out of a replay."""

    estimate: Trajectory  # without poses if there was no drive
    cloud: PointCloud | None  # the last one
    records: Sequence[CallRecord]  # all calls of localiser and mapper
    mapped_ns: tuple[int, ...]  # of the pairs of the cloud, in the order of the points' `pair`: their truth judges it
    external: ExternalRun | None = None  # its poses are converted by `external_poses.with_converted_poses`
    points: FloatArray | None = None  # `(N, 3)` in LM of an external mapper that tells no pixels


class ReplayFiles:
    """Places of the outputs of a replay."""

    def __init__(self, folder: Path) -> None:
        """Name the places; nothing is touched."""
        self.folder = folder
        self.estimate = folder / "estimate.csv"
        self.stats = folder / "stats.csv"  # one row for each call
        self.cloud = folder / "cloud.ply"
        self.report = folder / "report.json"
        self.page = folder / "report.html"
        self.points = folder / "cloud.npz"  # the cloud of an external mapper without pixels
        self.as_published = folder / "estimate_as_published.csv"  # of an external node, before it was converted
        self.external_log = folder / "external.log"

    @property
    def all(self) -> tuple[Path, ...]:
        """All of them."""
        return tuple(path for name, path in vars(self).items() if name != "folder")

    def remove(self) -> None:
        """Remove what an earlier replay has written; other files stay."""
        for path in self.all:
            path.unlink(missing_ok=True)


def save_replay(result: CollectedRun, files: ReplayFiles) -> None:
    """Write what there is of a replay but its score."""
    if len(result.estimate):
        save_trajectory(files.estimate, result.estimate)
    if result.records:
        save_stats(files.stats, result.records)
    if result.cloud is not None:
        save_cloud(files.cloud, result.cloud)
    if result.points is not None:
        save_points(files.points, result.points)
    if result.external is not None and result.external.as_published is not None:
        save_trajectory(files.as_published, result.external.as_published)
    if result.external is not None and result.external.log:
        write_text(result.external.log, files.external_log)


def score_replay(
    source: Source,
    result: CollectedRun,
    config: ScoreConfig,
    limits: Limits | None,
    *,
    files: ReplayFiles | None = None,
    settings: Mapping[str, object] = MappingProxyType({}),
    limits_file: Path | None = None,
    command: str | None = None,
) -> Score:
    """Return the score of a replay, by the functions that score files.

    Settings are those of localiser and mapper that differ from the defaults; they join those of the score. The files
    that `save_replay` has written, None without, the file of the limits and the command are for provenance.
    """
    stats = [stats_of(result.records)] if result.records else []
    inputs = ScoreInputs(limits=limits_file, command=command)
    how = AS_IT_IS if source.configuration is None else source_config(source.path, source.configuration)
    in_memory: dict[str, str] = {}
    if files is not None and stats:
        inputs = replace(inputs, stats=(files.stats,))
    drive = None
    truth, images = (None, None) if source.loc is None else (source.loc.ground_truth, source.expected_loc_ns())
    if source.loc is not None and truth is not None and len(result.estimate):
        estimate = result.estimate
        estimates = estimates_of_calls(estimate, stats)
        drive = DriveToScore(estimates, truth, source.loc.rig, images)
        inputs = replace(with_read_files(inputs, how), truth=source.path)
        if files is not None:
            inputs = replace(inputs, estimate=files.estimate)
        else:
            in_memory["estimate"] = hash_arrays((estimate.stamps_ns, estimate.positions, estimate.quats_xyzw))
    unposed = len(images) if images is not None and not len(result.estimate) else 0
    nav_stamps_ns, unmapped = None, 0
    if source.nav is not None:
        nav_stamps_ns = source.expected_nav_ns()
        unmapped = 0 if len(result.mapped_ns) == len(nav_stamps_ns) else len(nav_stamps_ns)
    if (cloud := _scored_cloud(source, result)) is not None:
        inputs = replace(with_read_files(inputs, how), map_truth=source.path)
        if files is not None:
            inputs = replace(inputs, cloud=files.cloud if result.points is None else files.points)
        else:
            in_memory["cloud"] = hash_arrays([cloud.loaded.xyz])
    task = Task.MAPPING if drive is None else Task.LOCALISATION
    run = Run(
        inputs,
        stats,
        drive=drive,
        cloud=cloud,
        method=record_of_ours(task),
        unposed_images=unposed,
        nav_stamps_ns=nav_stamps_ns,
        unmapped_pairs=unmapped,
        in_memory=in_memory,
        settings=settings,
    )
    if (node := result.external) is not None:
        run = replace(run, method=node.method, external=node.score, findings=node.findings, convention=node.convention)
    return score_run(run, config, limits)


def _scored_cloud(source: Source, result: CollectedRun) -> CloudToScore | None:
    xyz = result.points if result.cloud is None else result.cloud.xyz
    if source.nav is None or xyz is None:
        return None
    by_stamp = {pair.pair.stamp_ns: pair for pair in source.nav.pairs() if pair.pair.stamp_ns in result.mapped_ns}
    pairs = [by_stamp[stamp_ns] for stamp_ns in result.mapped_ns if stamp_ns in by_stamp]
    if not pairs or len(pairs) < len(result.mapped_ns) or any(pair.truth is None for pair in pairs):
        return None
    loaded = LoadedCloud(np.asarray(xyz, np.float64), result.cloud)
    return CloudToScore(loaded, truths_of(pairs, source.nav.rig))
