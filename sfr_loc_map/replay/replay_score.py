"""The score of a replay, from the messages that its nodes published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.calls.growing_calls import stats_of
from sfr_loc_map.hashes import hash_arrays
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.figures.records import REPLAY_RATE
from sfr_loc_map.metrics.map.pair_truth import truths_of
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.replay.files import ReplayFiles
from sfr_loc_map.replay.result import ReplayedMap, ReplayResult
from sfr_loc_map.scoring.input_files import CONFIGURATION_ROLES, ReadFile, configuration_files, read_files
from sfr_loc_map.scoring.inputs import CloudToScore, DriveToScore, ExpectedPairs, InMemory, ItemUnderTest, Origin, Run
from sfr_loc_map.scoring.load_calls import estimates_of_calls
from sfr_loc_map.scoring.load_map import pairs_of_cloud
from sfr_loc_map.scoring.score_run import score_run


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
    read: Mapping[str, ReadFile] | None = None,
    files: ReplayFiles | None = None,
    command: str | None = None,
) -> Score:
    """Return the score of a replay, computed by the functions that score files.

    The settings of the source and of our localiser and mapper are added to the settings of the score. The provenance
    requires the result of `files_of_source` (`read`), the files that `save_replay` has written (`files`), and the
    command line (`command`).
    """
    run = _run_of(source, result)
    settings = {f"{task}.{name}": value for task, of_task in result.settings.items() for name, value in of_task.items()}
    played = {} if result.rate is None else {REPLAY_RATE: result.rate}
    origin = Origin(
        _files_of(run, result, files_of_source(source) if read is None else read, files),
        _hashes_of(run, result) if files is None else {},
        truth_settings=source.config.truth.changed_content,
        settings={**source.changed_reading, **settings, **played},
        command=command,
    )
    return score_run(replace(run, origin=origin), config, limits)


def _run_of(source: Source, result: ReplayResult) -> Run:
    """Return the data of a replay that are scored, without their origin."""
    node = result.external
    stated_tasks = () if node is None else (node.task,)
    stats = [stats_of(result.records, estimate=result.estimate, stated_tasks=stated_tasks)] if result.records else []
    images_ns = None if source.loc is None else source.expected_loc_ns()
    pairs_ns = None if source.nav is None else source.expected_nav_ns()
    run = Run(
        stats=stats,
        drive=_scored_drive(source, result, stats),
        cloud=_scored_cloud(source, result.map),
        expected=ExpectedPairs(
            unposed_images=0 if images_ns is None or len(result.estimate) else len(images_ns),
            nav_stamps_ns=pairs_ns,
            unmapped=0 if pairs_ns is None else len(np.setdiff1d(pairs_ns, result.map.pair_stamps_ns)),
        ),
    )
    if node is None:
        return replace(run, item=ItemUnderTest(result.judged_method))
    item = ItemUnderTest(result.judged_method, node.score, node.findings)
    return replace(run, item=item, convention=node.convention)


def _files_of(
    run: Run, result: ReplayResult, read: Mapping[str, ReadFile], files: ReplayFiles | None
) -> dict[str, ReadFile]:
    """Return the files of the scored data by role: those of the source, and those of the replay if it wrote files."""
    roles = {"limits"}
    if run.drive is not None:
        roles |= {"truth", *CONFIGURATION_ROLES}
    if run.cloud is not None:
        roles |= {"map_truth", *CONFIGURATION_ROLES}
    of_source = {role: file for role, file in read.items() if role in roles}
    if files is None:
        return of_source
    cloud_file = files.points if result.map.cloud is None else files.cloud
    results = {"estimate": None if run.drive is None else files.estimate}
    results["cloud"] = None if run.cloud is None else cloud_file
    calls = {"stats_0": files.stats if result.has_stats else None}
    return {**read_files(results), **of_source, **read_files(calls)}


def _hashes_of(run: Run, result: ReplayResult) -> dict[str, str]:
    """Return the hashes of the scored results by role, for a replay without files."""
    hashes = InMemory(estimate=None if run.drive is None else result.estimate).hashes()
    if run.cloud is not None:
        hashes["cloud"] = hash_arrays([run.cloud.loaded.xyz])
    return hashes


def _scored_drive(source: Source, result: ReplayResult, stats: Sequence[CallStats]) -> DriveToScore | None:
    """Return the drive of a replay; None without true poses or without an estimate."""
    if source.loc is None or source.loc.ground_truth is None or not len(result.estimate):
        return None
    estimates = estimates_of_calls(result.estimate, stats)
    return DriveToScore(estimates, source.loc.ground_truth, source.loc.rig, source.expected_loc_ns())


def _scored_cloud(source: Source, made: ReplayedMap) -> CloudToScore | None:
    """Return the finite points of a map, with the number of the other points; None without a map or any truth.

    InputError if the source does not have a pair of the map, MetricsError if only some of its pairs have truth.
    """
    if source.nav is None or made.xyz is None:
        return None
    pairs = pairs_of_cloud(source.nav, made.pair_stamps_ns, source.path)
    if all(pair.truth is None for pair in pairs):
        return None
    points = np.asarray(made.xyz, np.float64)
    finite = np.asarray(np.isfinite(points).all(axis=1))
    cloud = None if made.cloud is None else made.cloud.select(finite)
    loaded = LoadedCloud(points[finite], cloud, not_finite=int(np.count_nonzero(~finite)))
    return CloudToScore(loaded, truths_of(pairs, source.nav.rig))
