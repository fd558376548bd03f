"""The absolute pose error as a result of evo, which `evo_res` compares with those of other runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.evo_result import evo_result_bytes
from sfr_loc_map.io.trajectory_file import trajectory_text
from sfr_loc_map.metrics.aligned_error import absolute_errors, aligned_errors, aligned_poses
from sfr_loc_map.metrics.config import AlignedErrorConfig


def save_evo_result(
    path: Path, estimate: Trajectory, truth: Trajectory, config: AlignedErrorConfig, names: Mapping[str, str]
) -> None:
    """Write the APE of the positions: statistics, single errors, aligned estimate and truth.

    Args:
        path: The zip file.
        estimate: Estimated poses.
        truth: True poses.
        config: Alignment and association.
        names: Names of both, `est_name` and `ref_name`.

    Raises:
        MetricsError: If no stamps are near enough, or the positions allow no alignment.
        OutputError: If the file cannot be written.
    """
    poses = aligned_poses(estimate, truth, config)
    errors = absolute_errors(poses).translation_m
    ape = aligned_errors(estimate, truth, config).ape
    stats = {item.name: getattr(ape.translation, item.name) for item in fields(ape.translation)}
    seconds = poses.stamps_ns / NS_PER_S
    info = {"title": ape.description, "label": "APE (m)", **names}
    arrays = {"error_array": errors, "timestamps": seconds, "seconds_from_start": seconds - seconds[0]}
    texts = {
        f"{names[key]}.tum": trajectory_text(Trajectory(poses.stamps_ns, each.positions, each.quats), tum=True)
        for key, each in (("est_name", poses.estimate), ("ref_name", poses.truth))
    }
    data = evo_result_bytes(info, stats | {"sse": float(np.square(errors).sum())}, arrays, texts)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
