"""The score of an estimate against its truth, from files or from what is in memory; the same calls as `sfr score`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict, Unpack

import numpy as np

from sfr_loc_map.api.cloud import PointCloud
from sfr_loc_map.api.paths import PathLike
from sfr_loc_map.api.score_result import Score
from sfr_loc_map.api.trajectory import Trajectory
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry import cloud as cloud_base
from sfr_loc_map.geometry import trajectory as base
from sfr_loc_map.geometry.pose_convention import PoseConvention
from sfr_loc_map.inputs import hash_arrays
from sfr_loc_map.io.cloud_file import LoadedCloud
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.metrics.config import aligned_error_config, score_config
from sfr_loc_map.metrics.limits import Limits, load_limits, parse_limits
from sfr_loc_map.pipeline.call_stats import CallStats, stats_of
from sfr_loc_map.pipeline.scoring import (
    Correction,
    Run,
    ScoredCloud,
    ScoredDrive,
    ScoreInputs,
    camera_rig,
    converted_run,
    load_drive,
    load_map_truth,
    load_run,
    said_fused,
    score_run,
)

Estimate = PathLike | base.Trajectory | cloud_base.PointCloud
Truth = PathLike | base.Trajectory | Source


class ScoreSettings(TypedDict, total=False):
    """Options of `sfr score` by the same names.

    Attributes:
        spacing: Frames from one start of a sub-trajectory to the next (10).
        rebase: What is taken from the estimate at a start: `pose` or `position`.
        associate: How an estimate finds its truth: `auto`, `match` or `interpolate`.
        max_gap: Longest gap of the truth that is interpolated, s (1).
        scored_range: Ranges of the truth that count for coverage, m (0, 10).
        fused: Whether the cloud is fused, for a file that does not say so.
        convention: How the poses were written: `["frame=left_optical", "world=first_pose"]`.
        apply_diagnosis: Whether to correct the convention mismatch that explains the errors.
        max_difference: Longest difference of stamps paired for APE and RPE, s (0.01).
        rpe_delta: Length of a relative error: `frames=1` or `distance=10`.
    """

    spacing: int
    rebase: str
    associate: str
    max_gap: float
    scored_range: tuple[float, float]
    fused: bool
    convention: Sequence[str]
    apply_diagnosis: bool
    max_difference: float
    rpe_delta: str


NAMES = {
    "spacing": "trajectory.spacing",
    "rebase": "trajectory.rebase",
    "associate": "trajectory.association.truth",
    "max_gap": "trajectory.association.max_gap_s",
}


def score(
    estimate: Estimate,
    truth: Truth,
    conditions: Sequence[str] | None = None,
    limits: PathLike | Mapping[str, object] | Limits | None = None,
    *,
    align: str | None = None,
    stats: Sequence[PathLike] = (),
    **settings: Unpack[ScoreSettings],
) -> Score:
    """Score an estimate against the truth; the same figures as `sfr score`.

    Args:
        estimate: A trajectory or a cloud: in memory or a file (csv, TUM, KITTI, EuRoC, evo, bag; .ply, .pcd, .npz).
        truth: A trajectory in memory or its file; a source with truth, as `sfr.open` gives it, or its path.
        conditions: Ends of a sub-trajectory: `distance=5`, `time=60`, `frames=100`; distance=5 where none is given.
        limits: Limits to judge by: a YAML file, or its content.
        align: Alignment of APE (ATE) and RPE, given beside the other figures: `none`, `origin`, `se3` or `sim3`.
        stats: Calls (time, memory, state, covariance), files of `sfr localise --stats`. What `sfr.localise` and
            `sfr.map` give brings its own.
        settings: See `ScoreSettings`.

    Raises:
        InputError: If something cannot be read.
        ConfigError: If an option or the limits are not valid.
        MetricsError: If estimate and truth have nothing in common.
    """
    correction = _correction(settings)
    low, high = settings.get("scored_range", (0.0, 10.0))
    named = {NAMES[name]: value for name, value in settings.items() if name in NAMES}
    config = score_config(
        conditions and _texts(conditions), named | {"map.scored_from_m": low, "map.scored_to_m": high}
    )
    files = [stats] if isinstance(stats, (str, Path)) else stats
    run = _run(estimate, truth, tuple(map(Path, files)), settings.get("fused"))
    if correction.is_wanted and run.drive is None:
        raise ConfigError("convention and apply_diagnosis are for trajectories: leave them out for a cloud")
    further = {"max_difference_s": settings.get("max_difference"), "rpe_delta": settings.get("rpe_delta")}
    aligned = aligned_error_config(align, further)
    run = converted_run(run, config, correction)
    return Score.of(score_run(run, config, _limits(limits), aligned))


def _correction(settings: ScoreSettings) -> Correction:
    unknown = set(settings) - set(ScoreSettings.__annotations__)
    if unknown:
        known = ", ".join(ScoreSettings.__annotations__)
        raise ConfigError(f"sfr.score has no setting '{sorted(unknown)[0]}': it has {known}")
    declared = PoseConvention.parse(_texts(settings.get("convention", ())))
    return Correction(declared, settings.get("apply_diagnosis", False))


def _texts(items: Sequence[str]) -> Sequence[str]:
    """Return texts; a single one is one, not its letters."""
    return [items] if isinstance(items, str) else items


def _limits(limits: PathLike | Mapping[str, object] | Limits | None) -> Limits | None:
    if limits is None or isinstance(limits, Limits):
        return limits
    return parse_limits(limits, "limits") if isinstance(limits, Mapping) else load_limits(Path(limits))


def _run(estimate: Estimate, truth: Truth, stats: tuple[Path, ...], fused: bool | None) -> Run:
    """Return what there is to score: files are read as the command reads them."""
    place = truth.path if isinstance(truth, Source) else truth
    if isinstance(estimate, cloud_base.PointCloud):
        if isinstance(place, base.Trajectory):
            raise ConfigError("a cloud is scored against a source with mapping pairs and truth, not a trajectory")
        return _cloud_run(estimate, Path(place), stats, fused)
    if not isinstance(estimate, base.Trajectory) and not isinstance(place, base.Trajectory):
        return load_run(ScoreInputs.of(Path(estimate), Path(place), stats), fused)
    return _drive_run(estimate, place, stats)


def _drive_run(estimate: PathLike | base.Trajectory, truth: PathLike | base.Trajectory, stats: tuple[Path, ...]) -> Run:
    """Return estimated poses and their truth; at least one of both is in memory."""
    inputs, in_memory, rig = ScoreInputs(stats=stats), {}, None
    read = [*load_run(inputs).stats]
    if isinstance(truth, base.Trajectory):
        in_memory["truth"] = _hash(truth)
    else:
        truth = Path(truth)
        inputs, rig = replace(inputs, truth=truth), camera_rig(truth)
    if isinstance(estimate, base.Trajectory):
        in_memory["estimate"] = _hash(estimate)
        read = [*read, *_own_stats(estimate)]
    else:
        estimate = Path(estimate)
        inputs = replace(inputs, estimate=estimate)
    drive = load_drive(estimate, truth, read)
    return Run(inputs, read, drive=ScoredDrive(drive.estimates, drive.truth, rig), in_memory=in_memory)


def _cloud_run(cloud: cloud_base.PointCloud, truth: Path, stats: tuple[Path, ...], fused: bool | None) -> Run:
    inputs = ScoreInputs(map_truth=truth, stats=stats)
    read = [*load_run(replace(inputs, map_truth=None)).stats, *_own_stats(cloud)]
    loaded = said_fused(LoadedCloud(cloud.xyz.astype(np.float64), cloud), fused, "the cloud")
    truths = load_map_truth(truth, cloud.pair_stamps_ns)
    in_memory = {"cloud": hash_arrays([cloud.to_structured()])}
    return Run(inputs, read, cloud=ScoredCloud(loaded, truths), in_memory=in_memory)


def _own_stats(estimate: object) -> list[CallStats]:
    """Return the calls that gave an estimate."""
    if isinstance(estimate, (Trajectory, PointCloud)) and estimate.records:
        return [stats_of(estimate.records, estimate.method)]
    return []


def _hash(poses: base.Trajectory) -> str:
    return hash_arrays((poses.stamps_ns, poses.positions, poses.quats_xyzw))
