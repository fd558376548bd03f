"""What identifies the run of calls: its poses, images, cloud and rate. A score compares them with its other inputs."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.hashes import hash_arrays

POSE_SIZE = 7  #: Numbers of a pose: position (m) and quaternion (x, y, z, w).


@dataclass(frozen=True, slots=True, eq=False)
class RunIdentity:
    """What identifies the run of `N` calls. A field is None if it is unknown."""

    positions: FloatArray | None = None  #: `(N, 3)` estimated positions of the calls, m, NaN without estimate.
    quats_xyzw: FloatArray | None = None  #: `(N, 4)` estimated attitudes of RB in DS, NaN without estimate.
    images_sha256: Sequence[str] | None = None  #: `(N,)` hash of the images of each call, empty if unknown.
    cloud_sha256: str | None = None  #: Hash of the cloud that the calls made (`hash_of_cloud`).
    replay_rate: float | None = None  #: Multiple of the recorded speed of a replay; None in lock step.


def hash_of_pair(pair: StereoPair) -> str:
    """Return the SHA-256 of the pixels of the two images of a pair."""
    return hash_arrays((pair.left, pair.right))


def hash_of_set(hashes: Sequence[str]) -> str:
    """Return the SHA-256 of the images of several pairs from the hashes of the pairs, in the order of the call."""
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def hash_of_cloud(cloud: PointCloud) -> str:
    """Return the SHA-256 of the finite points of a cloud with all their fields, independent of the format of its file.

    Points that are not finite are omitted when a file is read.
    """
    is_finite = np.asarray(np.isfinite(cloud.xyz).all(axis=1))
    return hash_arrays([cloud.select(is_finite).to_structured()])


def poses_by_stamp(estimate: Trajectory) -> dict[int, list[float]]:
    """Return position and quaternion `(7,)` of each pose of an estimate by stamp."""
    poses = np.hstack((estimate.positions, estimate.quats_xyzw))
    return dict(zip(estimate.stamps_ns.tolist(), poses.tolist(), strict=True))
