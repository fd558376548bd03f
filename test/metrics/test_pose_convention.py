"""Each way of writing poses is undone exactly; what is not declared stays to the last bit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfr_loc_map.errors import ConfigError, MetricsError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.conventions.pose_convention import (
    FRAMES,
    PoseConvention,
    aligned,
    converted,
    converted_estimates,
)
from sfr_loc_map.metrics.frames.association import Estimates

RIG = StereoRig(
    160, 120, 100.0, 100.0, 80.0, 60.0, 0.12,
    Transform(Rotation.from_euler("y", 20, degrees=True).as_matrix(), np.array([0.45, 0.1, 0.3])),
)  # fmt: skip


def drive(count: int = 40) -> Trajectory:
    rng = np.random.default_rng(3)
    quats = Rotation.random(count, random_state=4).as_quat()
    return Trajectory(np.arange(count) * 100_000_000, rng.normal(0, 20, (count, 3)), quats)


def written(poses: Trajectory, convention: PoseConvention, T_world_ds: Transform) -> Trajectory:
    """The poses as a node of that convention would write them, by transforms alone."""
    T_rb_child = convention.T_rb_child(RIG)
    positions, quats = [], []
    for index in range(len(poses)):
        pose = T_world_ds @ poses.pose(index) @ T_rb_child
        pose = pose.inverse() if convention.inverse else pose
        matrix, position = pose.rotation, pose.translation
        if convention.mirrored:
            mirror = np.diag([1.0, -1.0, 1.0])
            matrix, position = mirror @ matrix @ mirror, mirror @ position
        x, y, z, w = Rotation.from_matrix(matrix).as_quat()
        quats.append({"xyzw": (x, y, z, w), "wxyz": (w, x, y, z), "conjugated": (-x, -y, -z, w)}[convention.quaternion])
        positions.append(position / convention.metres_per_unit)
    return Trajectory(poses.stamps_ns - convention.time_offset_ns, np.array(positions), np.array(quats))


@pytest.mark.parametrize(
    "settings",
    [
        *([f"frame={frame}"] for frame in FRAMES),
        ["extrinsics=0.1,-0.2,0.3,0.5,0.5,-0.5,0.5"],
        ["quaternion=wxyz"],
        ["quaternion=conjugated", "frame=left_optical"],
        ["inverse=true", "metres_per_unit=0.001", "frame=right"],
        ["mirrored=true", "time_offset_ns=-123456789"],
        ["mirrored=true", "inverse=true", "quaternion=wxyz", "frame=sb", "metres_per_unit=0.3048"],
    ],
    ids=" ".join,
)
def test_what_was_written_in_a_convention_comes_back_as_poses_of_rb(settings: list[str]) -> None:
    convention, poses = PoseConvention.parse(settings), drive()
    T_world_ds = Transform(Rotation.from_euler("xyz", [0.3, 1.0, -2.0]).as_matrix(), np.array([5.0, -7.0, 2.0]))
    found = converted(written(poses, convention, T_world_ds), convention, convention.T_rb_child(RIG))
    found = aligned(found, T_world_ds.inverse())
    assert found.stamps_ns.tolist() == poses.stamps_ns.tolist()
    np.testing.assert_allclose(found.positions, poses.positions, rtol=0, atol=1e-11)
    turn = Rotation.from_quat(found.quats_xyzw).inv() * Rotation.from_quat(poses.quats_xyzw)
    assert turn.magnitude().max() < 1e-13
    assert PoseConvention.parse(convention.settings) == convention


def test_what_is_not_declared_stays_and_rounded_quaternions_do_not_lengthen_the_lever_arm() -> None:
    poses = drive()
    found = converted(poses, PoseConvention(), PoseConvention().T_rb_child(None))
    for name in ("stamps_ns", "positions", "quats_xyzw"):
        assert getattr(found, name).tobytes() == getattr(poses, name).tobytes()
    left, longer = PoseConvention(frame="left"), replace(poses, quats_xyzw=poses.quats_xyzw * 1.005)
    same, wanted = (converted(each, left, left.T_rb_child(RIG)).positions for each in (longer, poses))
    np.testing.assert_allclose(same, wanted, atol=1e-12)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["frame=left", "frame=right"], "given twice"),
        (["fram=left"], "did you mean 'frame'"),
        (["inverse=perhaps"], "Expected `bool`"),
        (["extrinsics=1,2,3"], "seven numbers"),
        (["extrinsics=0,0,0,0,0,0,0"], "quaternion is zero"),
        (["inverse=true", "inverse_motion=true"], "exclude each other"),
        (["frame=left", "extrinsics=0,0,0,0,0,0,1"], "extrinsics and frame=left exclude each other"),
        (["frame=left_optical"], "extrinsics=x,y,z"),
    ],
)
def test_a_setting_that_is_none_is_one_line(settings: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        PoseConvention.parse(settings).T_rb_child(None)


def test_the_left_camera_is_to_the_left_of_the_rig() -> None:
    """A child on the left has positive y in SB, half a baseline from the middle."""
    for frame, across in (("left", 0.06), ("sb", 0.0), ("right_optical", -0.06)):
        in_sb = RIG.T_rb_sb.inverse() @ PoseConvention.parse([f"frame={frame}"]).T_rb_child(RIG)
        np.testing.assert_allclose(in_sb.translation, [0.0, across, 0.0], atol=1e-12)


def test_no_poses_are_no_poses_in_any_convention() -> None:
    empty = Trajectory(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4)))
    for setting in ("inverse_motion=true", "inverse=true", "quaternion=wxyz", "mirrored=true"):
        assert len(converted(empty, PoseConvention.parse([setting]), Transform.identity())) == 0


def converted_in_order(estimates: Estimates, rows: np.ndarray, setting: str, truth: Trajectory | None) -> Trajectory:
    """The poses after the conversion of estimates in the order of `rows`, in the original order again."""
    convention = PoseConvention.parse([setting])
    found = converted_estimates(estimates.at_rows(rows), convention, Transform.identity(), truth)
    return found.at_rows(np.argsort(rows)).trajectory


@pytest.mark.parametrize("setting", ["inverse_motion=true", "world=first_pose", "inverse=true"])
@pytest.mark.parametrize("has_truth", [True, False])
def test_a_conversion_does_not_depend_on_the_order_of_the_poses(setting: str, has_truth: bool) -> None:
    poses = drive()
    truth = replace(poses, positions=poses.positions + 3.0) if has_truth else None
    lost = np.arange(len(poses)) < 3
    wanted = converted_in_order(Estimates.of(poses, lost), np.arange(len(poses)), setting, truth)
    for rows in (np.arange(len(poses))[::-1], np.roll(np.arange(len(poses)), 1)):
        found = converted_in_order(Estimates.of(poses, lost), rows, setting, truth)
        np.testing.assert_array_equal(found.positions, wanted.positions)
        np.testing.assert_array_equal(found.quats_xyzw, wanted.quats_xyzw)


def test_the_world_is_aligned_at_the_first_pose_that_is_not_lost() -> None:
    poses = drive()
    lost = np.arange(len(poses)) < 3
    convention = PoseConvention.parse(["world=first_pose"])
    found = converted_estimates(Estimates.of(poses, lost), convention, Transform.identity(), None).trajectory
    np.testing.assert_allclose(found.positions[3], 0.0, atol=1e-12)
    assert np.linalg.norm(found.positions[0]) > 1.0
    with pytest.raises(MetricsError, match="no pose that is not lost"):
        converted_estimates(Estimates.of(poses, np.ones(len(poses), np.bool_)), convention, Transform.identity(), None)


@pytest.mark.parametrize("setting", ["inverse=true", "world=first_pose", "frame=rb_optical", "mirrored=true"])
def test_an_estimate_without_attitudes_is_not_converted(setting: str) -> None:
    positions = replace(drive(), quats_xyzw=np.zeros((40, 4)))
    with pytest.raises(MetricsError, match="the estimate has only positions"):
        converted_estimates(Estimates.of(positions), PoseConvention.parse([setting]), Transform.identity(), None)
