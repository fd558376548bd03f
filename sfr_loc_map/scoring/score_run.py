"""The score of a finished run: the trajectory, the map, time and memory, and the verdicts on them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.hashes import hash_arrays
from sfr_loc_map.metrics.config import AlignedErrorConfig, ScoreConfig
from sfr_loc_map.metrics.frames.truth_error import as_truth
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.scoring.assembly import all_kept, score_of_parts, with_conditions
from sfr_loc_map.scoring.conversion import convention_mismatch, fitted_unit
from sfr_loc_map.scoring.inputs import Run, ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.provenance import provenance_of
from sfr_loc_map.scoring.score_parts import (
    calls_result,
    drive_result,
    expected_calls,
    map_result,
    result_without_cloud,
    result_without_poses,
    with_aligned_errors,
)


def score_files(inputs: ScoreInputs, config: ScoreConfig, limits: Limits | None = None) -> Score:
    """Return the score of files."""
    return score_run(load_run(inputs), config, limits)


def score_run(
    run: Run,
    config: ScoreConfig,
    limits: Limits | None = None,
    aligned: AlignedErrorConfig | None = None,
    kept_errors: Collection[tuple[str, str]] = (),
) -> Score:
    """Return the score of a run, including conditions that only the limits name; with `aligned`, also APE and RPE.

    All errors are kept for limited figures of the trajectory and for `kept_errors`.
    """
    config = with_conditions(config, limits)
    trajectory = result_without_poses(run.unposed_images)
    truth_sha256 = map_truth_sha256 = None
    if run.drive is not None:
        finding = fitted_unit(run.convention) or convention_mismatch(run.drive, config)
        trajectory = drive_result(run.drive, config.trajectory, finding, all_kept(limits, kept_errors))
        truth_sha256 = hash_of_truth(run.drive.truth)
    if run.drive is not None and aligned is not None:
        trajectory = with_aligned_errors(trajectory, run.drive, aligned)
    surface = result_without_cloud(run.unmapped_pairs)
    if run.cloud is not None:
        pairs = None if run.nav_stamps_ns is None else len(np.unique(run.nav_stamps_ns))
        surface = map_result(run.cloud, config.map, pairs)
        map_truth_sha256 = hash_arrays(truth.points for truth in run.cloud.truths)
    calls = calls_result(run, expected_calls(run))
    provenance = provenance_of(run, config, truth_sha256, map_truth_sha256)
    return score_of_parts(run, trajectory, surface, calls, provenance, config, limits)


def hash_of_truth(truth: Trajectory) -> str:
    """Return the SHA-256 of the poses of a ground truth, of their sigmas and of the lever arm."""
    known = as_truth(truth)
    stated = np.array((known.sigma_m, known.sigma_deg, *known.lever_arm_m))
    return hash_arrays((truth.stamps_ns, truth.positions, truth.quats_xyzw, stated))
