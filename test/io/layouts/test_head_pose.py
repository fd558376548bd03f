"""Poses of the mapping cameras by /tf or by the joints of a pan-tilt head [3.2.6]."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from pathlib import Path

import numpy as np
import pytest

from campaigns.recordings.bags import Recording, T, header, transform
from campaigns.recordings.drive import BEGIN_NS, Drive
from campaigns.recordings.rows import add_mapping
from helpers.made_worlds import random_pair
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.layouts.head_pose import head_poses
from sfr_loc_map.io.source_config import FramesConfig
from sfr_loc_map.simulation.config import PanoramaConfig

RIG = StereoRig(16, 12, 20.0, 20.0, 7.5, 5.5, 0.15)
PLACE = FramesConfig(head_to_navsb_m=(0.06, 0.0, 0.08), head_to_navsb_quat_xyzw=(0.0, 0.0, 0.0, 1.0))
TILT_AXIS = np.array([0.451, 0.317, 0.594])
MS = 1_000_000


def turned(pan: float, tilt: float) -> Transform:
    """Return T_rb_navsb by the formula of the document, for cameras that stand at (0.06, 0, 0.08) on the head."""
    c, s, ct, st = np.cos(pan), np.sin(pan), np.cos(tilt), np.sin(tilt)
    rotation = np.array([[c * ct, -s, c * st], [s * ct, c, s * st], [-st, 0.0, ct]])
    return Transform(rotation, TILT_AXIS + rotation @ [0.06, 0.0, 0.08])


def poses_of(recording: Recording, folder: Path, stamps: list[int], config: FramesConfig = PLACE) -> list[Transform]:
    bag = Bag(recording.write(folder / "bag"))
    return head_poses(bag, "pancam_left_optical", RIG.baseline_m, stamps, config)


def assert_near(found: Transform, wanted: Transform) -> None:
    assert np.abs(found.matrix - wanted.matrix).max() < 1e-9


def add_tf(recording: Recording, stamp_ns: int, parent: str, child: str, pose: Transform) -> None:
    recording.add("/tf", stamp_ns, T["tf2_msgs/msg/TFMessage"]([transform(stamp_ns, parent, child, pose)]))


def add_joints(recording: Recording, stamp_ns: int, **angles: float) -> None:
    kind, values = T["sensor_msgs/msg/JointState"], np.array([*angles.values()])
    recording.add("/joint_states", stamp_ns, kind(header(stamp_ns, ""), [*angles], values, np.zeros(0), np.zeros(0)))
    speeds = kind(header(stamp_ns, ""), [*angles], np.zeros(0), np.ones(len(angles)), np.zeros(0))
    recording.add("/joint_speeds", stamp_ns, speeds)


@pytest.mark.parametrize("head_by", ["joints", "tf"])
def test_a_head_that_was_recorded_gives_the_poses_of_the_document(head_by: str, tmp_path: Path) -> None:
    turns = np.radians([PanoramaConfig().pan_deg, PanoramaConfig().tilt_deg]).T.tolist()
    pair, truth = random_pair(np.random.default_rng(0), BEGIN_NS, (12, 16)), np.zeros((12, 16, 3), np.float32)
    nav = [PosedStereoPair(pair, Transform.identity(), truth)] * len(turns)
    recording = add_mapping(Recording(), Drive(RIG, [], truth, truth, RIG, nav), "/pancam", head_by)
    stamps = [BEGIN_NS + (k - 3) * 1000 * MS for k in range(len(turns))]
    add_tf(recording, stamps[0], "odom", "base_link", Transform.identity())  # above the rover: it does not matter
    broken = transform(stamps[0], "base_link", "gripper", Transform.identity())
    broken.transform.rotation.w = 0.0
    recording.add("/tf", stamps[0], T["tf2_msgs/msg/TFMessage"]([broken]))
    found = poses_of(recording, tmp_path, stamps, PLACE if head_by == "joints" else FramesConfig())
    for pose, (pan, tilt) in zip(found, turns, strict=True):
        assert_near(pose, turned(pan, tilt))


def test_angles_and_transforms_are_taken_between_messages(tmp_path: Path) -> None:
    joints, frames = Recording(), Recording()
    for k, (pan, tilt) in enumerate([(pi - 0.1, 0.2), (-pi + 0.3, 0.4)]):  # the joint turns on beyond half a turn
        stamp_ns = BEGIN_NS + k * 400 * MS
        add_joints(joints, stamp_ns, solar_panel=1.0 * k, mast_pan=pan, mast_tilt=tilt)
        add_tf(
            frames,
            stamp_ns,
            "rover1/base_link",
            "navsb",
            Transform(matrix_from_rotvec([0, 0, k]), np.array([k, 0.0, 2])),
        )
    (pose,) = poses_of(joints, tmp_path / "joints", [BEGIN_NS + 100 * MS])
    assert_near(pose, turned(pi, 0.25))
    (pose,) = poses_of(frames, tmp_path / "frames", [BEGIN_NS + 100 * MS], FramesConfig(base="rover1/base_link"))
    assert_near(pose, Transform(matrix_from_rotvec([0, 0, 0.25]), np.array([0.25, 0.0, 2.0])))


def joints_at(*milliseconds: int, **more: float) -> Recording:
    recording = Recording()
    for at in milliseconds:
        add_joints(recording, BEGIN_NS + at * MS, **(more or {"pan": 0.1, "tilt": 0.2}))
    return recording


def frames_at(*milliseconds: int, parent: str = "base_link", name: str = "pancam_left_optical") -> Recording:
    recording = joints_at(0, wheel=0.1)
    for at in milliseconds:
        tilt = Transform(matrix_from_rotvec([0.0, 0.001 * at, 0.0]), np.zeros(3))
        add_tf(recording, BEGIN_NS + at * MS, parent, name, tilt)
    return recording


REFUSED: dict[str, tuple[Callable[[], Recording], FramesConfig, str]] = {
    "after the joints": (lambda: joints_at(0, 400), PLACE, r"joint 'pan' at stamp 1700000000500000000 is unknown: rec"),
    "before the joints": (lambda: joints_at(600, 700), PLACE, "joint 'pan' at stamp 1700000000500000000 is unknown"),
    "a gap of the joints": (lambda: joints_at(0, 1400), PLACE, "is unknown: record it from before the first pair"),
    "a place not given": (
        lambda: joints_at(0, 900),
        FramesConfig(),
        "give their pose on the head by --set 'frames.head_to",
    ),
    "no joint of the head": (
        lambda: joints_at(0, 900, wheel=0.1),
        PLACE,
        "no transforms from the rover to 'pancam_left_optical', and 0 joints match 'pan' among wheel",
    ),
    "two that pan": (
        lambda: joints_at(0, 900, a_pan=0.1, b_pan=1.0, tilt=0.0),
        PLACE,
        "2 joints match 'pan' among a_pan, b_pan, tilt",
    ),
    "a name that is not there": (lambda: joints_at(0, 900), FramesConfig(tilt_joint="neck"), "0 joints match 'neck'"),
    "an angle that is none": (lambda: joints_at(0, 900, pan=np.nan, tilt=0.0), PLACE, "not finite"),
    "after the frames": (
        lambda: frames_at(0, 400),
        PLACE,
        "base_link to pancam_left_optical, which give the pose of the cameras, are incomplete",
    ),
    "frames of another rover": (
        lambda: frames_at(0, 900),
        FramesConfig(base="rb"),
        "record /tf, nav/pose or sensor_msgs",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_gives_no_pose_of_a_pair_is_refused_in_one_line(what: str, tmp_path: Path) -> None:
    make, config, words = REFUSED[what]
    with pytest.raises(InputError, match=words) as caught:
        poses_of(make(), tmp_path, [BEGIN_NS + 500 * MS], config)
    assert "\n" not in str(caught.value)
