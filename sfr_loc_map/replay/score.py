"""The score of a replay from the published messages of the nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from sfr_loc_map.calls.call_stats import CallStats, stats_of
from sfr_loc_map.hashes import hash_arrays
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.methods.registry import record_of_ours
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.errors.cloud_error import truths_of
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.replay.files import ReplayFiles
from sfr_loc_map.replay.result import ReplayResult
from sfr_loc_map.scoring.input_files import CONFIGURATION_ROLES, ReadFile, configuration_files, read_files
from sfr_loc_map.scoring.inputs import CloudToScore, ConvertedRun, DriveToScore, InMemory, Origin, Run
from sfr_loc_map.scoring.load_calls import estimates_of_calls
from sfr_loc_map.scoring.score_run import score_run
from sfr_loc_map.suite_names import Task


def files_of_source(source: Source, limits_file: Path | None = None) -> dict[str, ReadFile]:
    """Note the states of the files of a source and of its limits, before the source is played."""
    paths = {"truth": source.path, "map_truth": source.path, "limits": limits_file}
    return read_files({**paths, **configuration_files(source.config)})


def score_replay(
    source: Source,
    result: ReplayResult,
    config: ScoreConfig,
    limits: Limits | None,
    *,
    settings: Mapping[Task, Mapping[str, object]] = MappingProxyType({}),
    read: Mapping[str, ReadFile] | None = None,
    files: ReplayFiles | None = None,
    command: str | None = None,
) -> Score:
    """Return the score of a replay, computed by the functions that score files.

    `settings` are the settings of localiser and mapper that differ from the defaults. They are added to the settings of
    the score. For provenance, `read` has the result of `files_of_source`, and `files` those that `save_replay` has
    written.
    """
    stats = [stats_of(result.records, estimate=result.estimate)] if result.records else []
    drive, cloud = _scored_drive(source, result, stats), _scored_cloud(source, result)
    images = None if source.loc is None else source.expected_loc_ns()
    pairs = None if source.nav is None else source.expected_nav_ns()
    read = files_of_source(source, None) if read is None else read
    configuration = {f"{part}.{name}": value for part, own in settings.items() for name, value in own.items()}
    task = Task.MAPPING if drive is None else Task.LOCALISATION
    run = Run(
        replace(_origin(result, read, files, drive, cloud), settings=configuration, command=command),
        stats,
        drive=drive,
        cloud=cloud,
        method=record_of_ours(task, settings.get(task, {})),
        unposed_images=len(images) if images is not None and not len(result.estimate) else 0,
        nav_stamps_ns=pairs,
        unmapped_pairs=len(pairs) if pairs is not None and len(result.mapped_ns) != len(pairs) else 0,
    )
    if (node := result.external) is None:
        return score_run(ConvertedRun(run), config, limits)
    run = replace(run, method=node.method, external=node.score, findings=node.findings)
    return score_run(ConvertedRun(run, node.convention), config, limits)


def _origin(
    result: ReplayResult,
    read: Mapping[str, ReadFile],
    files: ReplayFiles | None,
    drive: DriveToScore | None,
    cloud: CloudToScore | None,
) -> Origin:
    """Return where the scored data are from: files of the source, and files of the replay or hashes without them."""
    roles = {"limits"}
    if drive is not None:
        roles |= {"truth", *CONFIGURATION_ROLES}
    if cloud is not None:
        roles |= {"map_truth", *CONFIGURATION_ROLES}
    of_source = {role: file for role, file in read.items() if role in roles}
    if files is None:
        estimate = None if drive is None else result.estimate
        in_memory = InMemory(estimate=estimate).hashes()
        if cloud is not None:
            in_memory["cloud"] = hash_arrays([cloud.loaded.xyz])
        return Origin(of_source, in_memory)
    cloud_file = files.points if result.cloud is None else files.cloud
    results = {"estimate": None if drive is None else files.estimate, "cloud": None if cloud is None else cloud_file}
    calls = {"stats_0": files.stats if result.records else None}
    return Origin({**read_files(results), **of_source, **read_files(calls)})


def _scored_drive(source: Source, result: ReplayResult, stats: Sequence[CallStats]) -> DriveToScore | None:
    """Return the drive of a replay; None without true poses or without an estimate."""
    if source.loc is None or source.loc.ground_truth is None or not len(result.estimate):
        return None
    estimates = estimates_of_calls(result.estimate, stats)
    return DriveToScore(estimates, source.loc.ground_truth, source.loc.rig, source.expected_loc_ns())


def _scored_cloud(source: Source, result: ReplayResult) -> CloudToScore | None:
    """Return the finite points of the map, with the number of the other points; None without a map or its truth."""
    xyz = result.points if result.cloud is None else result.cloud.xyz
    if source.nav is None or xyz is None:
        return None
    by_stamp = {pair.pair.stamp_ns: pair for pair in source.nav.pairs() if pair.pair.stamp_ns in result.mapped_ns}
    pairs = [by_stamp[stamp_ns] for stamp_ns in result.mapped_ns if stamp_ns in by_stamp]
    if not pairs or len(pairs) < len(result.mapped_ns) or any(pair.truth is None for pair in pairs):
        return None
    points = np.asarray(xyz, np.float64)
    finite = np.asarray(np.isfinite(points).all(axis=1))
    cloud = None if result.cloud is None else result.cloud.select(finite)
    loaded = LoadedCloud(points[finite], cloud, not_finite=int(np.count_nonzero(~finite)))
    return CloudToScore(loaded, truths_of(pairs, source.nav.rig))
