"""Estimates of another convention, converted to poses of RB in DS before they are scored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.pose_convention import FIRST_POSE, PoseConvention, aligned, converted, lever_arms
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform, propagation
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.trajectory.association import COVARIANCE_SIZE, UPPER, Estimates, associate


def converted_estimates(
    estimates: Estimates, convention: PoseConvention, T_rb_child: Transform, truth: Trajectory | None
) -> Estimates:
    """Return estimates as poses of RB in DS.

    A covariance is carried along; where poses are inverted or mirrored it is left out. Steps (`step_cov`) are motions
    of RB: they stay only where nothing but the world frame or the stamps differ.

    Args:
        estimates: As they were written.
        convention: In what they differ.
        T_rb_child: Pose in RB of the frame they are of.
        truth: True poses, for a world frame that is aligned at the first pose; None: the first pose is the identity.

    Raises:
        MetricsError: If no pose has a true pose to align the world frame with.
        GeometryError: If what comes out are no poses.
    """
    poses = converted(estimates.trajectory, convention, T_rb_child)
    covariance = None if convention.inverse or convention.mirrored else estimates.covariance
    if covariance is not None:
        covariance = _converted_covariance(covariance, convention, lever_arms(poses, T_rb_child))
    plain = convention == PoseConvention(world=convention.world, time_offset_ns=convention.time_offset_ns)
    result = replace(
        estimates, trajectory=poses, covariance=covariance, steps=estimates.steps if plain else None, sums=None
    )
    if convention.world != FIRST_POSE:
        return result
    T_ds_world = world_at_first_pose(result, truth)
    if covariance is not None:
        covariance = _rotated_covariance(covariance, T_ds_world.rotation)
    return replace(result, trajectory=aligned(poses, T_ds_world), covariance=covariance)


def world_at_first_pose(estimates: Estimates, truth: Trajectory | None) -> Transform:
    """Return `T_ds_world` that takes the first pose that is not lost and has a true pose to it.

    Args:
        estimates: Poses of RB in their world frame.
        truth: True poses, None: the first pose is the identity.

    Raises:
        MetricsError: If no pose has a true pose.
    """
    if truth is None:
        if not len(estimates.trajectory):
            raise MetricsError("there is no pose to align the world frame at: give an estimate with poses")
        return estimates.trajectory.pose(0).inverse()
    frames = associate(replace(estimates, steps=None), truth, AssociationConfig())[0]
    known = np.flatnonzero(~frames.lost)
    if not len(known):
        raise MetricsError("no pose has a true pose to align the world frame with: check the stamps, or world=ds")
    first = int(known[0])
    true = Transform.from_quat(frames.gt_pos[first], frames.gt_quat[first])
    return true @ Transform.from_quat(frames.est_pos[first], frames.est_quat[first]).inverse()


def _converted_covariance(covariance: FloatArray, convention: PoseConvention, arms: FloatArray) -> FloatArray:
    """Return covariances `(N, 21)` in metres, of RB in place of a frame from which RB lies at `arms` `(N, 3)`."""
    if convention.metres_per_unit == 1.0 and not convention.of_another_frame:
        return covariance
    unit = np.diag([convention.metres_per_unit] * 3 + [1.0] * 3)
    carry = np.array([propagation(arm) @ unit for arm in arms]).reshape(-1, 6, 6)
    return _upper(carry @ _full(covariance) @ carry.transpose(0, 2, 1))


def _rotated_covariance(covariance: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return covariances `(N, 21)` in axes that `rotation` `(3, 3)` turns theirs into."""
    turn = np.kron(np.eye(2), rotation)
    return _upper(turn @ _full(covariance) @ turn.T)


def _full(covariance: FloatArray) -> FloatArray:
    full = np.empty((len(covariance), 6, 6))
    full[:, UPPER[0], UPPER[1]] = full[:, UPPER[1], UPPER[0]] = covariance
    return full


def _upper(full: FloatArray) -> FloatArray:
    return np.ascontiguousarray(full[:, UPPER[0], UPPER[1]]).reshape(-1, COVARIANCE_SIZE)
