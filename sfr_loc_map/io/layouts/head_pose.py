"""Poses of the mapping cameras in RB for bags without nav/pose: from /tf, or from the joint angles of the head."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.extrinsics import BASE_FRAMES, NAVSB_FRAME, mast_head_in_rb, rig_in_body
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.stamped_poses import covered, sampled
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.frames import chain_above
from sfr_loc_map.io.bag.poses import read_frames
from sfr_loc_map.io.source_config import FramesConfig
from sfr_loc_map.io.stamps.stamp_checks import check_stamp_order
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import JOINTS

RECORDING = "from before the first pair until after the last pair, at 1 Hz or more"


def head_poses(
    bag: Bag, camera_frame: str, baseline_m: float, stamps_ns: Sequence[int], frames: FramesConfig
) -> list[Transform]:
    """Return `T_rb_navsb` at each stamp from the transforms between rover and left camera, else from joint angles.

    InputError if the bag has neither, or does not cover each stamp.
    """
    stamps = np.array(stamps_ns, np.int64)
    with refusing(f"bag '{bag.path}'", "record it again"):
        poses = _by_tf(bag, camera_frame, baseline_m, stamps, frames.base.strip("/"))
        return _by_joints(bag, camera_frame, stamps, frames) if poses is None else poses


def _by_tf(bag: Bag, camera_frame: str, baseline_m: float, stamps_ns: IntArray, base: str) -> list[Transform] | None:
    """Return the poses from /tf and /tf_static; None without stamps or a connection between rover and camera.

    At each stamp the transforms that are known at this stamp give the pose. All transforms, known or not, show whether
    the frames are connected at all, so that a gap in the recording is an error and a missing connection is not.
    """
    if not len(stamps_ns):
        return None
    frames = _frames_at(bag, stamps_ns, (NAVSB_FRAME, camera_frame.strip("/"), *([base] if base else BASE_FRAMES)))
    rig = rig_in_body(_tree(frames, -1, with_unknown=True), camera_frame, baseline_m, base, NAVSB_FRAME)
    if rig is None:
        return None
    T_rb_navsb: list[Transform] = []
    for row, stamp in enumerate(stamps_ns):
        tree = _tree(frames, row, with_unknown=False)
        rig_at_stamp = rig_in_body(tree, camera_frame, baseline_m, base, NAVSB_FRAME)
        if rig_at_stamp is None:
            raise InputError(
                f"bag '{bag.path}': at stamp {stamp} the transforms on /tf from {rig.read_from}, which give the pose "
                f"of the cameras, are incomplete:",
                f"record /tf {RECORDING}",
            )
        if rig_at_stamp.text != rig.text:
            raise InputError(
                f"bag '{bag.path}': the pose of the cameras is given by the transforms on /tf from {rig.text}, but at "
                f"stamp {stamp} by those from {rig_at_stamp.text}:",
                f"record /tf {RECORDING}",
            )
        T_rb_navsb.append(rig_at_stamp.T_rb_sb)
    return T_rb_navsb


class _FrameAtStamps(NamedTuple):
    """A frame on /tf or /tf_static at given stamps."""

    name: str
    parent: str
    poses: list[Transform]  #: Poses in the parent, interpolated; extrapolated outside of the recorded time.
    is_known: Mask  #: Whether the recording covers each stamp.


def _frames_at(bag: Bag, stamps_ns: IntArray, ends: Collection[str]) -> list[_FrameAtStamps]:
    """Return the frames with the names `ends`, and all frames above them, at stamps `(N,)`."""
    recorded = read_frames(bag)
    found = [name for name in recorded if name in ends or name.rpartition("/")[2] in ends]
    frames = []
    for name in {name for end in found for name in chain_above(recorded, end)}:
        frame = recorded[name]
        check_stamp_order(frame.poses.stamps_ns, f"bag '{bag.path}', '{name}' on /tf", strict=False)
        is_known = covered(frame.poses.stamps_ns, stamps_ns) | frame.is_static
        poses = [Transform.from_quat(*pose) for pose in zip(*sampled(frame.poses, stamps_ns), strict=True)]
        frames.append(_FrameAtStamps(name, frame.parent, poses, is_known))
    return frames


def _tree(frames: Sequence[_FrameAtStamps], row: int, *, with_unknown: bool) -> FrameTree:
    """Return the tree of frames at the stamp of a row, with or without frames that are unknown at this stamp."""
    tree = FrameTree()
    for frame in frames:
        if with_unknown or frame.is_known[row]:
            tree.add(frame.parent, frame.name, frame.poses[row])
    return tree


def _by_joints(bag: Bag, camera_frame: str, stamps_ns: IntArray, config: FramesConfig) -> list[Transform]:
    """Return the poses from the angles of the pan and the tilt joint, and the position of the cameras on the head."""
    recorded = _joint_angles(bag)
    angles = []
    for kind, wanted in (("pan", config.pan_joint), ("tilt", config.tilt_joint)):
        name = _joint_name(recorded, kind, wanted, f"bag '{bag.path}'", camera_frame)
        angles.append(_angles_at(stamps_ns, recorded[name], f"bag '{bag.path}', joint '{name}'"))
    T_head_navsb = config.head_transform()
    if T_head_navsb is None:
        raise InputError(
            f"bag '{bag.path}': the cameras are moved by joints:",
            "give their pose on the head by "
            "--set 'frames.head_to_navsb_m=[X, Y, Z]' --set 'frames.head_to_navsb_quat_xyzw=[X, Y, Z, W]'",
        )
    return [mast_head_in_rb(float(pan), float(tilt)) @ T_head_navsb for pan, tilt in zip(*angles, strict=True)]


def _joint_angles(bag: Bag) -> dict[str, list[tuple[int, float]]]:
    """Return the stamps (ns) and angles (rad) of each joint in all topics of joint states."""
    angles = dict[str, list[tuple[int, float]]]()
    for _, _, message in bag.messages([Topic(n, n, kind) for n, kind in bag.topics.items() if kind == JOINTS]):
        for name, angle in zip(message.name, message.position.tolist(), strict=False):  # some have no position
            angles.setdefault(name, []).append((stamp_of(message), angle))
    return angles


def _joint_name(names: Collection[str], kind: str, wanted: str, where: str, camera_frame: str) -> str:
    """Return the name of the pan or tilt joint; InputError if no joint or several joints match."""
    matching = [name for name in names if (name == wanted if wanted else kind in name.lower())]
    as_word = [name for name in matching if kind in re.split("[^a-z]+", name.lower())]
    matching = as_word or matching  # 'panel' contains 'pan'
    if len(matching) != 1:
        raise InputError(
            f"{where} has no transforms from the rover to '{camera_frame}', and {len(matching)} joints match "
            f"'{wanted or kind}' among {', '.join(sorted(names)) or '(none)'}: one joint is required;",
            "record /tf, nav/pose or sensor_msgs/JointState, or set frames.base, frames.pan_joint, frames.tilt_joint",
        )
    return matching[0]


def _angles_at(stamps_ns: IntArray, recorded: Sequence[tuple[int, float]], where: str) -> FloatArray:
    """Return the interpolated angles of a joint at stamps; InputError if a stamp is not covered."""
    known_ns, angles = (np.array(column) for column in zip(*recorded, strict=True))
    check_stamp_order(known_ns, where, strict=False)
    unknown_ns = stamps_ns[~covered(known_ns, stamps_ns)]
    if len(unknown_ns):
        raise InputError(f"{where} at stamp {unknown_ns[0]} is unknown:", f"record it {RECORDING}")
    return np.asarray(np.interp(stamps_ns - known_ns[0], known_ns - known_ns[0], np.unwrap(angles)))
