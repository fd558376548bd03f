"""The score of a replay from the published messages of the nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from sfr_loc_map.calls.call_stats import stats_of
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
from sfr_loc_map.scoring.inputs import CloudToScore, DriveToScore, Run, ScoreInputs
from sfr_loc_map.scoring.load import estimates_of_calls, with_read_files
from sfr_loc_map.scoring.score_run import score_run
from sfr_loc_map.suite_names import Task


def score_replay(
    source: Source,
    result: ReplayResult,
    config: ScoreConfig,
    limits: Limits | None,
    *,
    files: ReplayFiles | None = None,
    settings: Mapping[Task, Mapping[str, object]] = MappingProxyType({}),
    limits_file: Path | None = None,
    command: str | None = None,
) -> Score:
    """Return the score of a replay, computed by the functions that score files.

    `settings` are the settings of localiser and mapper that differ from the defaults. They are added to the settings of
    the score. The files that `save_replay` has written, the file of the limits and the command are for provenance.
    """
    stats = [stats_of(result.records, estimate=result.estimate)] if result.records else []
    inputs = ScoreInputs(limits=limits_file, command=command)
    in_memory: dict[str, str] = {}
    if files is not None and stats:
        inputs = replace(inputs, stats=(files.stats,))
    drive = None
    truth, images = (None, None) if source.loc is None else (source.loc.ground_truth, source.expected_loc_ns())
    if source.loc is not None and truth is not None and len(result.estimate):
        estimate = result.estimate
        estimates = estimates_of_calls(estimate, stats)
        drive = DriveToScore(estimates, truth, source.loc.rig, images)
        inputs = replace(with_read_files(inputs, source.config), truth=source.path)
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
        inputs = replace(with_read_files(inputs, source.config), map_truth=source.path)
        if files is not None:
            inputs = replace(inputs, cloud=files.cloud if result.points is None else files.points)
        else:
            in_memory["cloud"] = hash_arrays([cloud.loaded.xyz])
    task = Task.MAPPING if drive is None else Task.LOCALISATION
    configuration = {f"{part}.{name}": value for part, own in settings.items() for name, value in own.items()}
    run = Run(
        inputs,
        stats,
        drive=drive,
        cloud=cloud,
        method=record_of_ours(task, settings.get(task, {})),
        unposed_images=unposed,
        nav_stamps_ns=nav_stamps_ns,
        unmapped_pairs=unmapped,
        in_memory=in_memory,
        settings=configuration,
    )
    if (node := result.external) is not None:
        run = replace(run, method=node.method, external=node.score, findings=node.findings, convention=node.convention)
    return score_run(run, config, limits)


def _scored_cloud(source: Source, result: ReplayResult) -> CloudToScore | None:
    xyz = result.points if result.cloud is None else result.cloud.xyz
    if source.nav is None or xyz is None:
        return None
    by_stamp = {pair.pair.stamp_ns: pair for pair in source.nav.pairs() if pair.pair.stamp_ns in result.mapped_ns}
    pairs = [by_stamp[stamp_ns] for stamp_ns in result.mapped_ns if stamp_ns in by_stamp]
    if not pairs or len(pairs) < len(result.mapped_ns) or any(pair.truth is None for pair in pairs):
        return None
    loaded = LoadedCloud(np.asarray(xyz, np.float64), result.cloud)
    return CloudToScore(loaded, truths_of(pairs, source.nav.rig))
