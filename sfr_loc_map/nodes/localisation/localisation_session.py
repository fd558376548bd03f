"""The localiser of a node, with its start pose across resets, faults and restarts of the process.

A new process starts at the pose that the previous process saved, unless a pose is set. A reset is a restart whose first
pose is the identity. After a change of rig or configuration, or a fault, the localiser continues at its last pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sfr_loc_map.errors import InputError, LocalisationError, OutputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose, TrackingState
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.nodes.localisation.pose_file import PoseFile

LocaliserFactory = Callable[[StereoRig, LocalisationConfig, StartPose], Localiser]


class LocalisationSession:
    """Owns the localiser of a node; for use by a single thread.

    The table shows the state after each transition. The localiser of this run starts at `_start`, and the localisers of
    later runs start at `_first`. `_last` is the last published pose that was not lost. If `may_resume` is true, the
    next pair starts a localiser at the pose that the previous process saved.

    | transition | `_first` | `_start` | `_last` | `_localiser` | `may_resume` |
    |---|---|---|---|---|---|
    | `set_pose` | given pose | given pose | None | moved to the pose | False |
    | `set_first` | given pose | kept | kept | kept | kept |
    | `restart` | kept | `_first` | None | None | False |
    | `reset` | identity | identity | None | None | False |
    | `continue_at_last_pose` | kept | `_last` if a localiser has run | kept | None | kept |
    | `localiser_at` without a localiser | kept | saved pose if `may_resume` | kept | started at `_start` | False |
    | `accept` | kept | stamp of its first pair is added | the estimate unless lost | kept | kept |

    `set_config`, `set_rig` with other cameras, and `accept` with an invalid covariance continue at the last pose.
    """

    def __init__(
        self,
        config: LocalisationConfig,
        pose_file: PoseFile | None = None,
        warn: Callable[[str], None] = lambda text: None,
        make_localiser: LocaliserFactory = Localiser,
    ) -> None:
        """Start at the identity, or at the pose that the previous process saved in a file."""
        self.may_resume = pose_file is not None
        self._config = config
        self._pose_file = pose_file
        self._warn = warn
        self._make_localiser = make_localiser
        self._rig: StereoRig | None = None
        self._localiser: Localiser | None = None
        self._first = StartPose(Transform.identity())
        self._start = self._first
        self._last: StartPose | None = None  # the last pose that was published and not lost

    # ---- transitions

    def set_rig(self, rig: StereoRig) -> bool:
        """Set the rig of the next pair; its extrinsics may be unknown. Return whether the cameras have changed."""
        if self._rig is not None and self._rig.same_cameras(rig):
            self._rig = replace(self._rig, T_rb_sb=rig.T_rb_sb)
            return False
        has_changed = self._rig is not None
        self._rig = rig
        self.continue_at_last_pose()
        return has_changed

    def set_config(self, config: LocalisationConfig) -> None:
        """Set the configuration."""
        self._config = config
        self.continue_at_last_pose()

    def set_pose(self, given: StartPose) -> None:
        """Continue, or start, at a given pose, which is valid at its stamp; later runs start at this pose, too.

        Components that are unknown in the given pose are taken from the known pose at its stamp (`_known_at`).

        If the pose is invalid (`StartPose.of`), raise a GeometryError and change nothing.
        """
        pose = StartPose.of(completed_pose(StartPose.of(given, "the external pose"), self._known_at(given.stamp_ns)))
        self._first = replace(pose, stamp_ns=None)
        self._start = pose
        self._last = None
        self.may_resume = False
        if self._localiser is not None:
            self._localiser.set_pose(pose)

    def set_first(self, pose: StartPose) -> None:
        """Set the start pose of later runs; this run continues unchanged.

        If the pose is invalid (`StartPose.of`), raise a GeometryError and change nothing.
        """
        self._first = replace(StartPose.of(pose), stamp_ns=None)

    def restart(self) -> None:
        """Start a new run at the first pose."""
        self._start = self._first
        self._last = None
        self._localiser = None
        self.may_resume = False

    def reset(self) -> None:
        """Start a new run at the identity."""
        self._first = StartPose(Transform.identity())
        self.restart()

    def continue_at_last_pose(self) -> None:
        """Let the next pair start a localiser at the last known pose, with its covariance and its stamp."""
        if self._localiser is not None and self._last is not None:
            self._start = self._last
        self._localiser = None

    def _known_at(self, stamp_ns: int | None) -> StartPose:
        """Return the known pose at a stamp, with the covariance of the last known pose.

        Without a stamp, return the last known pose; before the first published pose, return the start pose. The
        covariance of the last pose is an upper bound for earlier poses, unless an external pose was applied in between.
        """
        if self._last is None:
            return self._start
        if self._localiser is None or stamp_ns is None:
            return self._last
        T_ds_rb = self._localiser.pose_at(stamp_ns)
        return self._last if T_ds_rb is None else replace(self._last, T_ds_rb=T_ds_rb)

    # ---- a pair

    def localiser_at(self, stamp_ns: int) -> Localiser:
        """Return the localiser for a pair; start a localiser if there is none.

        InputError if the extrinsics of the rig are unknown.
        """
        if self._localiser is not None:
            return self._localiser
        rig = self._rig
        if rig is None or rig.T_rb_sb is None:
            raise InputError(
                "the extrinsics of the stereo rig are unknown: give the parameters T_rb_locsb.translation_m and "
                "T_rb_locsb.quat_xyzw, or publish them on /tf_static"
            )
        if self.may_resume and self._pose_file is not None:
            self.may_resume = False
            try:
                self._start = self._pose_file.load(stamp_ns, rig) or self._start
            except InputError as error:
                self._warn(str(error))
            if self._start.stamp_ns is not None:
                gap_s = (stamp_ns - self._start.stamp_ns) * 1e-9
                self._warn(
                    f"localisation resumes at the pose from {gap_s:.1f} s earlier: the motion since then is unknown"
                )
        self._localiser = self._make_localiser(rig, self._config, self._start)
        return self._localiser

    def accept(self, estimate: PoseEstimate) -> None:
        """Record an estimate of the localiser, at which the next localiser may start."""
        if not (np.isfinite(estimate.covariance).all() and (np.diag(estimate.covariance) >= 0.0).all()):
            self.continue_at_last_pose()
            raise LocalisationError(
                f"the covariance of the pose of stamp {estimate.stamp_ns} is invalid: the pose is not published, and "
                f"localisation restarts at its last pose"
            )
        if self._start.stamp_ns is None:  # the start pose is valid at this pair
            self._start = replace(self._start, stamp_ns=estimate.stamp_ns)
        if estimate.state is TrackingState.LOST:
            return
        self._last = StartPose(estimate.T_ds_rb, estimate.covariance, estimate.stamp_ns)
        if self._pose_file is not None and self._rig is not None:
            try:
                self._pose_file.save(self._last, self._rig)
            except OutputError as error:
                self._warn(str(error))


def completed_pose(given: StartPose, known: StartPose) -> StartPose:
    """Return a given pose; components that its covariance marks as unknown are taken from a known pose.

    Tools that set a pose on a plane, such as RViz, send variances of x, y and yaw, and zeros for z, roll and pitch.
    Others, such as two-dimensional filters, mark unknown components by variances of at least `LOST_VARIANCE`. A
    covariance that is zero states an exact pose. Roll and pitch describe the tilt in RB. Their covariance, which is
    about the fixed axes of DS, is therefore rotated with the yaw.
    """
    is_given = given.covariance.any(axis=1) & (np.diag(given.covariance) < LOST_VARIANCE)
    if is_given.all() or not is_given.any():
        return given
    known_components = _components(known.T_ds_rb)
    x, y, z, roll, pitch, yaw = np.where(is_given, _components(given.T_ds_rb), known_components)
    turns = [matrix_from_rotvec(rotvec) for rotvec in ([0.0, 0.0, yaw], [0.0, pitch, 0.0], [roll, 0.0, 0.0])]
    with_yaw = np.eye(6)
    with_yaw[3:, 3:] = matrix_from_rotvec([0.0, 0.0, yaw - known_components[5]])
    known_covariance = with_yaw @ known.covariance @ with_yaw.T
    covariance = np.where(np.outer(~is_given, ~is_given), known_covariance, 0.0)
    covariance += np.where(np.outer(is_given, is_given), given.covariance, 0.0)
    pose = Transform(turns[0] @ turns[1] @ turns[2], np.array([x, y, z]))
    return StartPose(pose, covariance, given.stamp_ns)


def _components(pose: Transform) -> FloatArray:
    """Return position and roll, pitch, yaw about fixed axes, in the order of a ROS covariance."""
    rotation = pose.rotation
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    pitch = -math.asin(min(max(rotation[2, 0], -1.0), 1.0))
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    return np.array([*pose.translation, roll, pitch, yaw])
