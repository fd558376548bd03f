"""What the drive of a source and its ground truth add to a proposal: extrinsics, lever arm, condition of the score."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sfr_loc_map.configuration.sections import Key
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.io.layouts.bag_source import BagLocSequence
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.io.truth.names import is_tracker
from sfr_loc_map.metrics.config import SPACING_FRAMES
from sfr_loc_map.source_setup.proposal import Proposal, Value

SHORT_M = 12.0  #: Shorter drives, m, have too few sub-trajectories of 5 m, so 1 m is proposed.


def with_extrinsics(proposal: Proposal, loc: LocSequence) -> Proposal:
    """Add the extrinsics that the bag has, because some nodes cannot read /tf_static."""
    T_rb_sb = loc.rig.T_rb_sb
    if T_rb_sb is None:
        text = (
            "no extrinsics of the cameras on the rover: give --set 'extrinsics.translation_m=[X, Y, Z]' "
            "--set 'extrinsics.quat_xyzw=[X, Y, Z, W]' (LOCSB in RB)"
        )
        return proposal.adding(missing=[text])
    if proposal.config.extrinsics.transform() is not None:
        return proposal
    mount = loc.mount if isinstance(loc, BagLocSequence) else None
    if mount is None:
        return proposal.adding(remarks=["extrinsics are those of the source (rig.json or the calibration)"])
    reason = f"from {mount.text}; {'unsure' if mount.other_bases else 'sure'}"
    values = (
        Value(Key("extrinsics", "translation_m"), T_rb_sb.translation.tolist(), reason),
        Value(Key("extrinsics", "quat_xyzw"), T_rb_sb.quat_xyzw.tolist(), reason),
    )
    remark = f"extrinsics are from {mount.text}: if RB is another frame, give --set frames.base=NAME"
    return proposal.adding(*values, remarks=[remark] if mount.other_bases else [])


def with_lever_arm(proposal: Proposal, truth: Truth) -> Proposal:
    """Add the remark that the lever arm is assumed to be 0, if the truth is probably that of another body than RB."""
    config = proposal.config
    file = config.truth.file
    name = (file.name if file is not None else config.truth.source) or config.truth.frame or "of the source"
    if truth.has_attitude and not is_tracker(name):
        return proposal
    text = f"the truth {name} is assumed to track RB (lever arm 0): give --set 'truth.lever_arm_m=[X, Y, Z]'"
    return proposal.adding(remarks=[text])


def with_condition(proposal: Proposal, stamps_ns: Sequence[int], truth: Truth) -> Proposal:
    """Add a condition with at least two sub-trajectories in the drive."""
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)))
    left_m = along_m[-1] - np.interp(stamps_ns, truth.stamps_ns, along_m)[::SPACING_FRAMES]
    metres = 5 if along_m[-1] >= SHORT_M else 1
    pairs = len(stamps_ns)
    reason = f"the true path is {along_m[-1]:.1f} m long"
    if np.sum(left_m >= metres) >= 2:
        return proposal.adding(Value(Key("conditions"), [f"distance={metres}"], reason))
    frames = max(1, min(SPACING_FRAMES, pairs - SPACING_FRAMES - 1))
    remark = f"too few pairs for a verdict: {pairs} ({SPACING_FRAMES + 2} are required)"
    return proposal.adding(
        Value(Key("conditions"), [f"frames={frames}"], reason), remarks=[remark] if pairs < SPACING_FRAMES + 2 else []
    )
