"""Converted estimates: aligned at the first pose, covariance carried along, steps only where they still hold."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.pose_convention import PoseConvention
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.association import UPPER, Estimates
from sfr_loc_map.metrics.convention import converted_estimates

T_RB_CAMERA = Transform(Rotation.from_euler("xyz", [-1.2, 0.4, -1.6]).as_matrix(), np.array([0.45, 0.12, 0.8]))
WORLD = Transform(Rotation.from_euler("xyz", [0.7, -0.2, 2.0]).as_matrix(), np.array([3.0, 9.0, -1.0]))
COUNT = 12


def truth() -> Trajectory:
    positions = np.cumsum(np.random.default_rng(1).normal(0, 1, (COUNT, 3)), axis=0)
    return Trajectory(np.arange(COUNT) * 100, positions, Rotation.random(COUNT, random_state=2).as_quat())


def camera_poses() -> Trajectory:
    """The same drive, written by a node of the camera in a world frame of its own."""
    poses = [WORLD @ truth().pose(k) @ T_RB_CAMERA for k in range(COUNT)]
    return Trajectory.from_poses(zip(truth().stamps_ns.tolist(), poses, strict=True))


def test_the_first_pose_that_is_not_lost_is_aligned_with_the_truth() -> None:
    lost = np.arange(COUNT) < 2
    convention = PoseConvention(world="first_pose")
    found = converted_estimates(Estimates.of(camera_poses(), lost), convention, T_RB_CAMERA, truth())
    # the convention declares RB: the camera's pose itself is aligned with that of RB, at the third frame
    np.testing.assert_allclose(found.trajectory.positions[2], truth().positions[2], atol=1e-12)
    of_camera = PoseConvention(world="first_pose", extrinsics=(*T_RB_CAMERA.translation, *T_RB_CAMERA.quat_xyzw))
    found = converted_estimates(Estimates.of(camera_poses(), lost), of_camera, T_RB_CAMERA, truth())
    np.testing.assert_allclose(found.trajectory.positions, truth().positions, atol=1e-12)
    turn = Rotation.from_quat(found.trajectory.quats_xyzw).inv() * Rotation.from_quat(truth().quats_xyzw)
    assert turn.magnitude().max() < 1e-13


def test_without_truth_the_first_pose_is_the_identity() -> None:
    of_camera = PoseConvention(world="first_pose", extrinsics=(*T_RB_CAMERA.translation, *T_RB_CAMERA.quat_xyzw))
    found = converted_estimates(Estimates.of(camera_poses()), of_camera, T_RB_CAMERA, None)
    np.testing.assert_allclose(found.trajectory.pose(0).matrix, np.eye(4), atol=1e-12)
    elsewhere = Trajectory(truth().stamps_ns + 10**15, truth().positions, truth().quats_xyzw)
    with pytest.raises(MetricsError, match="no pose has a true pose"):
        converted_estimates(Estimates.of(camera_poses()), of_camera, T_RB_CAMERA, elsewhere)


def test_the_covariance_is_that_of_sampled_poses() -> None:
    """Law: perturb the camera's pose by its covariance, convert, and the scatter of RB is the converted covariance."""
    rng = np.random.default_rng(5)
    root = rng.normal(0, 1e-4, (6, 6))
    camera, count = camera_poses().pose(3), 4000
    noise = rng.normal(0, 1, (count, 6)) @ root.T
    positions = camera.translation + noise[:, :3]
    quats = (Rotation.from_rotvec(noise[:, 3:]) * Rotation.from_matrix(camera.rotation)).as_quat()
    sampled = Trajectory(np.arange(count), positions, quats)
    convention = PoseConvention(extrinsics=(*T_RB_CAMERA.translation, *T_RB_CAMERA.quat_xyzw))
    covariance = np.tile((root @ root.T)[UPPER], (count, 1))
    found = converted_estimates(Estimates.of(sampled, covariance=covariance), convention, T_RB_CAMERA, None)
    mean = Rotation.from_quat(found.trajectory.quats_xyzw).mean()
    turns = (Rotation.from_quat(found.trajectory.quats_xyzw) * mean.inv()).as_rotvec()
    scatter = np.cov(np.hstack((found.trajectory.positions, turns)).T)
    assert found.covariance is not None
    full = np.zeros((6, 6))
    full[UPPER] = found.covariance[0]
    full = full + np.triu(full, 1).T
    np.testing.assert_allclose(scatter, full, atol=0.1 * np.abs(full).max())
    assert np.abs(full - root @ root.T).max() > 0.3 * np.abs(full).max()  # the lever arm matters here


def test_steps_stay_only_where_they_still_hold() -> None:
    estimates = Estimates.of(camera_poses(), steps=np.ones((COUNT, 27)), covariance=np.ones((COUNT, 21)))
    kept = converted_estimates(estimates, PoseConvention(world="first_pose"), T_RB_CAMERA, truth())
    assert kept.steps is not None
    assert converted_estimates(estimates, PoseConvention(frame="left"), T_RB_CAMERA, truth()).steps is None
    assert converted_estimates(estimates, PoseConvention(inverse=True), T_RB_CAMERA, truth()).covariance is None
