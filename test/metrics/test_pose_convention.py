"""Each way of writing poses is undone exactly; what is not declared stays to the last bit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.conventions.pose_convention import FRAMES, PoseConvention, aligned, converted

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
        (["frame=left", "extrinsics=0,0,0,0,0,0,1"], "and no frame=NAME"),
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
