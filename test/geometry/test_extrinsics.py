"""The pose of a rig on the rover is recovered from frames as drivers publish them."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.geometry.extrinsics import mast_head_in_rb, rig_in_body
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform

RIG = StereoRig(640, 480, 500.0, 500.0, 320.0, 240.0, 0.12)
T_RB_SB = Transform(matrix_from_rotvec([0.02, 0.3, -0.1]), np.array([0.4, -0.1, 0.6]))
MOUNT = Transform(matrix_from_rotvec([0.0, 0.4, 0.2]), np.array([0.3, 0.0, 0.5]))
UP = Transform(np.eye(3), np.array([0.0, 0.0, 0.15]))


def tree(base: str, leaf: str, T_base_leaf: Transform, *, downwards: bool = True) -> FrameTree:
    """Join a base by a mount to a leaf, in a tree of the base or, as with some drivers, in one of the camera."""
    frames, middle = FrameTree(), "camera_link"
    frames.add(base, "wheel", UP)
    frames.add("elsewhere", "nothing", UP)
    if downwards:
        frames.add(base, middle, MOUNT)
        frames.add(middle, leaf, MOUNT.inverse() @ T_base_leaf)
    else:
        frames.add(middle, base, MOUNT.inverse())
        frames.add(middle, leaf, MOUNT.inverse() @ T_base_leaf)
    return frames


@pytest.mark.parametrize("downwards", [True, False])
@pytest.mark.parametrize("base", ["rb", "base_link", "rover1/base_footprint", "hull"])
def test_any_depth_and_any_base_lead_to_the_pose_of_the_rig(base: str, downwards: bool) -> None:
    optical = T_RB_SB @ RIG.T_sb_left
    body = Transform(T_RB_SB.rotation, T_RB_SB.apply([0.0, 0.5 * RIG.baseline_m, 0.0]))
    for leaf, pose in (("zed_left_camera_optical_frame", optical), ("cam", optical), ("cam", body), ("locsb", T_RB_SB)):
        frames = tree(base, leaf, pose, downwards=downwards)
        wanted = base if base == "hull" else ""
        found = rig_in_body(frames, leaf if leaf != "locsb" else "camera_link", RIG.baseline_m, wanted)
        assert found is not None
        assert found.text.startswith(f"{base} to {leaf}")
        np.testing.assert_allclose(found.T_rb_sb.matrix, T_RB_SB.matrix, atol=1e-12)


def test_other_frames_that_could_be_the_rovers_are_returned() -> None:
    frames = tree("base_link", "left_optical", T_RB_SB)
    frames.add("base_footprint", "base_link", UP)
    found = rig_in_body(frames, "left_optical", RIG.baseline_m)
    assert found is not None
    assert found.other_bases == ("base_footprint",)
    assert found.text == "base_link to left_optical; the rover's frame could also be base_footprint"
    chosen = rig_in_body(frames, "left_optical", RIG.baseline_m, "base_link")
    assert chosen is not None
    assert chosen.text == "base_link to left_optical"


def test_what_is_not_joined_to_a_base_is_unknown() -> None:
    frames = tree("base_link", "left_optical", T_RB_SB)
    assert rig_in_body(frames, "other_optical", 0.1) is None
    assert rig_in_body(frames, "nothing", 0.1) is None
    assert rig_in_body(frames, "left_optical", 0.1, "odom") is None
    assert rig_in_body(frames, "", 0.1) is None
    loop = FrameTree()
    loop.add("a", "b", UP)
    loop.add("b", "a", UP)
    assert loop.find("c", "a") is None
    assert loop.find("base_link", "a") is None


def test_the_pan_carries_the_tilt() -> None:
    """Panned left by a right angle and tilted down by 0.3 rad, the head looks left and down, and is level across."""
    rotation = mast_head_in_rb(np.pi / 2, 0.3).rotation
    np.testing.assert_allclose(rotation[:, 0], [0.0, np.cos(0.3), -np.sin(0.3)], atol=1e-12)
    np.testing.assert_allclose(rotation[:, 1], [-1.0, 0.0, 0.0], atol=1e-12)
