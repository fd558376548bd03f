"""Random drives whose estimates have the errors of a method and no convention mismatch."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sfr_loc_map.geometry.trajectory import Trajectory, Truth


def positions_of(truth: Trajectory) -> Truth:
    """The truth with positions alone."""
    return Truth(truth.stamps_ns, truth.positions, np.zeros_like(truth.quats_xyzw))


KINDS = ("noise", "drift", "scale", "outliers", "last frames", "short", "straight", "standing")


def honest_drive(seed: int) -> tuple[str, Trajectory, Trajectory]:
    """The kind of a random drive, its estimate and its truth: up to 300 frames, one of the kinds in turn."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    frames = int(rng.integers(20, 60) if kind == "short" else rng.integers(60, 300))
    step = rng.uniform(0.03, 0.2)
    turning = 0.0 if kind in ("straight", "standing") else rng.uniform(0.002, 0.03)
    yaw = np.cumsum(np.convolve(rng.normal(0.0, turning, frames), np.ones(5) / 5, "same"))
    tilt = 0.03 * np.sin(np.arange(frames)[:, None] * rng.uniform(0.02, 0.3, 2) + rng.uniform(0, 6, 2))
    true = Rotation.from_euler("ZYX", np.column_stack([yaw, tilt * (kind != "straight")]))
    speed = np.full(frames, 0.0 if kind == "standing" else step)
    moves = true.apply(np.column_stack([speed, np.zeros((frames, 2))]))
    noise = 10.0 ** rng.uniform(-4.0, -2.0)
    turned = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.1 * noise, (frames, 3)), axis=0))
    scale = 1.0 + rng.normal(0.0, 0.01) * (kind in ("scale", "short", "outliers"))
    bias = Rotation.from_rotvec(np.arange(frames)[:, None] * rng.normal(0.0, 1e-4, 3) * (kind == "drift"))
    walked = (bias * turned).apply(scale * moves) + rng.normal(0.0, noise * step, (frames, 3))
    positions = np.cumsum(walked, axis=0) + rng.normal(0.0, 0.1 * noise, (frames, 3))
    attitudes = bias * turned * true
    if kind == "outliers":
        some = rng.choice(frames, max(frames // 30, 1), replace=False)
        positions[some] += rng.normal(0.0, 2.0, (len(some), 3))
    if kind == "last frames":
        last = int(rng.integers(1, 4))
        positions[-last:] += rng.normal(0.0, 5.0 * step, 3) + 10.0 * step * np.array([1.0, 0.0, 0.0])
    stamps = 1_700_000_000_000_000_000 + np.arange(frames) * int(rng.choice([10**8, 5 * 10**8, 10**9]))
    world: Any = Rotation.from_euler("z", rng.uniform(-3.0, 3.0)) if rng.random() < 0.5 else Rotation.identity()
    return (
        kind,
        Trajectory(stamps, world.apply(positions), (world * attitudes).as_quat()),
        Trajectory(stamps, np.cumsum(moves, axis=0), true.as_quat()),
    )
