"""The pose of a stereo rig on the rover, from the frames that drivers publish or from the angles of the mast head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.message_text import alternatives

RB_FRAME = "rb"  #: Frame of the rover [3.2.2].
LOCSB_FRAME = "locsb"  #: Frame of the stereo rig for localisation [3.2.3].
NAVSB_FRAME = "navsb"  #: Frame of the stereo rig for mapping [3.2.3].
BASE_FRAMES = (RB_FRAME, "base_link", "base_footprint", "base", "body", "chassis")
"""Names of the rover's body frame. The first name that is connected to the camera is used."""
MAST_XY_RB_M = (0.451, 0.317)
"""x and y in RB of the mast base (DMA), of the pan axis, and of the tilt axis at pan 0, metres [3.2.2, 3.2.6]."""
TILT_AXIS_Z_RB_M = 0.594  #: Height of the tilt axis in RB, metres [3.2.6].


@dataclass(frozen=True, slots=True, eq=False)
class RigInBody:
    """The pose of a stereo rig on the rover, and the frames or the topic that the pose was read from."""

    T_rb_sb: Transform  #: Takes points in SB to RB.
    read_from: str  #: The frames or the topic, for messages: `base_link to camera_left_optical_frame`.
    other_bases: tuple[str, ...] = ()  #: Other connected frames that could be the rover's frame.

    @property
    def text(self) -> str:
        """`read_from`, with the other frames that could be the rover's frame, for messages."""
        if not self.other_bases:
            return self.read_from
        return f"{self.read_from}; the rover's frame could also be {alternatives(self.other_bases)}"


def rig_in_body(
    frames: FrameTree, camera_frame: str, baseline_m: float, base_frame: str = "", sb_frame: str = LOCSB_FRAME
) -> RigInBody | None:
    """Return the pose of a stereo rig in the rover's frame; None if the frames of rig and rover are not connected.

    The pose is that of the frame `sb_frame`. If `sb_frame` is not connected to the rover's frame, the pose is computed
    from the frame of the rectified left camera. The camera's frame is assumed to be optical (REP 103), with one
    exception. If the name does not contain "optical" and the z axis is within 45 deg of upwards, the axes are assumed
    to be x forward, y left, z up, as in simulators.

    The rover's frame is `base_frame`, or the first of `BASE_FRAMES` that is connected to the camera. Frame names may
    have a prefix (`rover1/base_link`). Slashes at the ends of names are ignored.
    """
    base_frame, camera_frame, sb_frame = (name.strip("/") for name in (base_frame, camera_frame, sb_frame))
    for frame in (sb_frame, camera_frame):
        joined = frames.joined_to(frame) if frame else []
        bases = _frames_of_names(joined, (base_frame,) if base_frame else BASE_FRAMES)
        T_base_frame = frames.find(bases[0], frame) if bases else None
        if T_base_frame is None:
            continue
        read_from = f"{bases[0]} to {frame}"
        other_bases = tuple(bases[1:])
        if frame == sb_frame:
            return RigInBody(T_base_frame, read_from, other_bases)
        camera_from_body = OPTICAL_IN_BODY.T
        if "optical" not in frame and T_base_frame.rotation[2, 2] > np.cos(np.pi / 4):
            read_from += ", taken as x forward and z up"
            camera_from_body = np.eye(3)
        T_left_sb = Transform(camera_from_body, camera_from_body @ np.array([0.0, -0.5 * baseline_m, 0.0]))
        return RigInBody(T_base_frame @ T_left_sb, read_from, other_bases)
    return None


def _frames_of_names(frames: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return the frames that have one of the names, in the order of the names; prefixed frames last."""
    found = []
    for name in names:
        found += [frame for frame in frames if frame == name]
        found += [frame for frame in frames if frame.endswith(f"/{name}")]
    return found


def mast_head_in_rb(pan_rad: float, tilt_rad: float) -> Transform:
    """Return `T_rb_head`, the pose of the mast head; the origin is where the pan and tilt axes meet.

    Pan is a rotation about z of RB, positive to the left, and also rotates the tilt axis. Tilt is a rotation about y of
    RB at pan 0, positive downwards.
    """
    pan: FloatArray = matrix_from_rotvec([0.0, 0.0, pan_rad])
    tilt: FloatArray = matrix_from_rotvec([0.0, tilt_rad, 0.0])
    return Transform(pan @ tilt, np.array([*MAST_XY_RB_M, TILT_AXIS_Z_RB_M]))
