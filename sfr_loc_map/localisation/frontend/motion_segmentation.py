"""Landmarks that a pose does not explain, and those among them that are fixed to the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.jit import jit
from sfr_loc_map.localisation.frontend.foreign_regions import stays
from sfr_loc_map.localisation.frontend.landmarks import BORDER, MIN_INVERSE_DEPTH, Landmarks
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, TrackingResult

MIN_MOTION_PX = 2.0
"""Image motion that distinguishes what is fixed to the camera from the ground."""
MIN_FIXED = 12
"""Minimum number of landmarks that are taken as fixed to the camera."""
MIN_FIXED_SHARE = 0.25
"""Minimum share of them among the unexplained landmarks: a few look fixed by chance."""


@dataclass(frozen=True, slots=True, eq=False)
class Unexplained:
    """Landmarks that a pose does not explain.

    Attributes:
        uv: `(M, 2)` where the pose sees them in the left image, pixels; NaN behind the camera.
        in_view: `(M,)` landmarks that should be in view.
        rows: `(M,)` those of them that do not agree with the pose.
        fixed: `(M,)` landmarks that are still seen at their host pixel though the pose moves them.
    """

    uv: FloatArray
    in_view: Mask
    rows: Mask
    fixed: Mask

    def share_of(self, rows: Mask) -> float:
        """Return the share of some of them `(M,)` in the landmarks in view."""
        return float(rows.sum() / max(int(self.in_view.sum()), 1))


def project(pose: Pose, landmarks: Landmarks, camera: StereoCamera) -> FloatArray:
    """Return the left pixels `(M, 2)` of landmarks; NaN behind the camera. Those at infinity are taken as far away."""
    inverse_depth = np.maximum(landmarks.inverse_depth, MIN_INVERSE_DEPTH)
    directions = np.einsum("nij,nj->ni", landmarks.hosts.rotations, landmarks.rays)
    scaled = (directions + inverse_depth[:, None] * (landmarks.hosts.positions - pose.position)) @ pose.rotation
    depth = np.where(scaled[:, 2] > 1e-6, scaled[:, 2], np.nan)
    x, y = scaled[:, 0] / depth, scaled[:, 1] / depth
    return np.column_stack((camera.fx * x + camera.cx, camera.fy * y + camera.cy))


def high_distance(uv: FloatArray, other: FloatArray) -> float:
    """Return the 90th percentile of the distances of pixels `(N, 2)` from others that are not NaN; 0 if all are."""
    distance = np.linalg.norm(uv - other, axis=1)
    distance = distance[np.isfinite(distance)]
    return float(np.percentile(distance, 90)) if len(distance) else 0.0


def stays_in(frame: StereoFrame, landmarks: Landmarks) -> Mask:
    """Tell which landmarks `(M,)` the left image still shows at their host pixels."""
    return stays(frame.left.levels[0], landmarks.patches.level(0).values[:, 0], landmarks.uv)


@jit
def _where_seen(
    pose: Pose,
    hosts: Poses,
    rays: FloatArray,
    inverse_depth: FloatArray,
    host_uv: FloatArray,
    camera: StereoCamera,
    shape: tuple[int, int],
) -> tuple[FloatArray, Mask, Mask]:
    """Return where a pose sees landmarks `(M, 2)`, which `(M,)` lie in an image of a shape, and which have moved.

    They have moved if that is away from their host pixels, or behind the camera. See `project`.
    """
    height, width = shape
    count = len(inverse_depth)
    in_view, moved = np.zeros(count, np.bool_), np.ones(count, np.bool_)
    direction, seen, uv = np.empty(3), np.empty(3), np.full((count, 2), np.nan)
    for n in range(count):
        rho = max(inverse_depth[n], MIN_INVERSE_DEPTH)
        for i in range(3):
            direction[i] = rho * (hosts.positions[n, i] - pose.position[i])
            for j in range(3):
                direction[i] += hosts.rotations[n, i, j] * rays[n, j]
        for j in range(3):
            seen[j] = 0.0
            for i in range(3):
                seen[j] += direction[i] * pose.rotation[i, j]
        if not seen[2] > 1e-6:
            continue
        u, v = camera.fx * seen[0] / seen[2] + camera.cx, camera.fy * seen[1] / seen[2] + camera.cy
        uv[n, 0], uv[n, 1] = u, v
        in_view[n] = BORDER < u < width - 1 - BORDER and BORDER < v < height - 1 - BORDER
        moved[n] = not (abs(u - host_uv[n, 0]) < MIN_MOTION_PX and abs(v - host_uv[n, 1]) < MIN_MOTION_PX)
    return uv, in_view, moved


def unexplained_by(result: TrackingResult, frame: StereoFrame, camera: StereoCamera) -> Unexplained:
    """Return the landmarks that a result does not explain."""
    landmarks, outliers = result.landmarks, ~result.inliers
    host_rays = landmarks.hosts, landmarks.rays, landmarks.inverse_depth, landmarks.uv
    uv, in_view, moved = _where_seen(result.pose, *host_rays, camera, frame.image.shape)
    rows = in_view & outliers
    fixed = np.zeros(len(landmarks), np.bool_)
    candidates = np.flatnonzero(outliers & moved)
    if len(candidates) >= MIN_FIXED:
        patches = landmarks.patches.level(0).values[candidates, 0]
        fixed[candidates] = stays(frame.left.levels[0], patches, landmarks.uv[candidates])
    if fixed.sum() < max(MIN_FIXED, MIN_FIXED_SHARE * rows.sum()):
        fixed[:] = False
    return Unexplained(uv, in_view, rows, fixed)


def pose_difference(one: Pose, other: Pose) -> tuple[float, float]:
    """Return the distance, metres, and the angle, radians, between two poses."""
    angle = np.linalg.norm(rotvec_from_matrix(one.rotation.T @ other.rotation))
    return float(np.linalg.norm(one.position - other.position)), float(angle)
