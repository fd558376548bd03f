"""Motions of keyframes against the host of a landmark, as functions of the poses of all keyframes."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Poses
from sfr_loc_map.geometry.rotation import skew


def motions_by_poses(keyframes: Poses) -> FloatArray:
    """Return how the motions of K keyframes against each host follow from the poses, `(K, 6 K + 1, 6 K + 1)`.

    What a keyframe sees stays where it is if the host moves as if the keyframe were fixed to it. A pose is a position
    and a rotation about the world's axes; the last unknown, which is no pose, follows from itself.
    """
    count = len(keyframes.positions)
    crosses = np.stack([skew(position) for position in keyframes.positions])
    out = np.tile(np.eye(6 * count + 1), (count, 1, 1))
    for h, cross in enumerate(crosses):
        by_host = out[h, :-1, 6 * h : 6 * h + 6].reshape(count, 6, 6)
        by_host[:] = -np.eye(6)
        by_host[:, :3, 3:] = crosses - cross
        by_host[h] = 0.0
    return out


def system_of_poses(upper: FloatArray, rhs: FloatArray, keyframes: Poses) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of poses from those of the motions against each host.

    Args:
        upper: `(K, 6 K + 1, 6 K + 1)` normal matrices, of which the upper half is read.
        rhs: `(K, 6 K + 1)` right-hand sides.
        keyframes: `(K,)` left cameras.

    Returns:
        Normal matrix `(6 K + 1, 6 K + 1)` and right-hand side `(6 K + 1,)`.
    """
    to_motions = motions_by_poses(keyframes)
    to_poses = to_motions.swapaxes(1, 2)
    information = np.triu(upper) + np.triu(upper, 1).swapaxes(1, 2)
    system = np.asarray((to_poses @ information @ to_motions).sum(axis=0))
    return system, np.asarray((to_poses @ rhs[:, :, None]).sum(axis=0)[:, 0])
