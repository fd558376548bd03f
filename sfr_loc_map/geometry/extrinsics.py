"""The pose of a stereo rig on the rover from a tree of frames, as the drivers of cameras and robots publish them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.config import param
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY
from sfr_loc_map.geometry.transform import FrameTree, Transform

RB_FRAME, LOCSB_FRAME, NAVSB_FRAME = "rb", "locsb", "navsb"
BASE_FRAMES = (RB_FRAME, "base_link", "base_footprint", "base", "body", "chassis")
"""Names of the rover's own frame, in the order of trying."""
COULD_BE = "the rover's frame could also be"  #: In the text where several of `BASE_FRAMES` are joined.
MAST_XY_RB_M = (0.451, 0.317)  #: Base of the mast (DMA) and the pan axis in RB [3.2.2, 3.2.6].
TILT_AXIS_Z_RB_M = 0.594  #: Height of the tilt axis in RB [3.2.6].
TILT_AXIS_X_RB_M = 0.451  #: Place of the tilt axis along RB x at pan 0 [3.2.6].


@dataclass(frozen=True, slots=True)
class FramesConfig:
    """The frames of a rover, and the joints of its head [3.2.6]."""

    base: str = param("", doc="Frame of the rover; empty: the first of rb, base_link, base_footprint, base, body.")
    pan_joint: str = param("", doc="Joint that turns the head to the left; empty: the one whose name has 'pan'.")
    tilt_joint: str = param("", doc="Joint that tilts the head down; empty: the one whose name has 'tilt'.")
    head_to_navsb_m: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), unit="m", doc="Position of NAVSB in the head that the joints move.", low=-10.0, high=10.0
    )
    head_to_navsb_quat_xyzw: tuple[float, ...] = param(
        (0.0, 0.0, 0.0, 0.0), doc="Orientation of NAVSB in the head; all zero: as the head.", low=-1.01, high=1.01
    )


@dataclass(frozen=True, slots=True, eq=False)
class RigInBody:
    """Where a stereo rig is on the rover, and from which frames that follows."""

    T_rb_sb: Transform
    text: str  #: `base_link to camera_left_optical_frame`, for messages.


def rig_in_body(
    frames: FrameTree, camera_frame: str, baseline_m: float, base_frame: str = "", sb_frame: str = LOCSB_FRAME
) -> RigInBody | None:
    """Return the pose of a rig by a frame of SB, else by the frame of its rectified left camera, at any depth.

    The camera's frame is optical [REP 103]; one that is not called so and whose z axis points up is taken as x
    forward, y left, z up, as simulators name it. The base is `base_frame`, else the first of `BASE_FRAMES` that is
    joined to the camera; frames of one rover may have a prefix (`rover1/base_link`). None where nothing joins them.
    """
    for frame in (sb_frame, camera_frame.strip("/")):
        joined = frames.joined_to(frame) if frame else []
        wanted = (base_frame,) if base_frame else BASE_FRAMES  # as they are, or with a prefix
        bases = [n for base in wanted for n in sorted(joined, key=base.__ne__) if f"/{n}".endswith(f"/{base}")]
        T_base_frame = frames.find(bases[0], frame) if bases else None
        if T_base_frame is None:
            continue
        text = f"{bases[0]} to {frame}"
        if len(bases) > 1:
            text += f"; {COULD_BE} {' or '.join(bases[1:])}"
        if frame == sb_frame:
            return RigInBody(T_base_frame, text)
        turn = OPTICAL_IN_BODY.T
        if "optical" not in frame and T_base_frame.rotation[2, 2] > np.cos(np.pi / 4):
            text, turn = f"{text}, taken as x forward and z up", np.eye(3)
        T_left_sb = Transform(turn, turn @ np.array([0.0, -0.5 * baseline_m, 0.0]))
        return RigInBody(T_base_frame @ T_left_sb, text)
    return None


def mast_head_in_rb(pan_rad: float, tilt_rad: float) -> Transform:
    """Return `T_rb_head`: the mast head, origin where the tilt axis meets the pan axis' x-z plane [3.2.6].

    Pan is about z of RB, positive to the left, and carries the tilt axis; tilt about y of RB at pan 0, positive down.
    """
    pan: FloatArray = matrix_from_rotvec([0.0, 0.0, pan_rad])
    tilt: FloatArray = matrix_from_rotvec([0.0, tilt_rad, 0.0])
    return Transform(pan @ tilt, np.array([TILT_AXIS_X_RB_M, MAST_XY_RB_M[1], TILT_AXIS_Z_RB_M]))
