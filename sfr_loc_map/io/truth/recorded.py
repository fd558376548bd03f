"""True poses as recorded, before they are checked and converted to poses of RB."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform


@dataclass(frozen=True, slots=True, eq=False)
class RecordedTruth:
    """Poses of a tracked body (RB itself, a marker, a prism, an antenna) with the stamps of its tracker."""

    poses: Trajectory
    read_from: str  #: File, topic or frame of the poses, for messages and reports.
    variances: FloatArray | None = None  #: `(N, 6)` of x, y, z, roll, pitch, yaw, m^2 and rad^2; NaN or None: unknown.
    T_rb_body: Transform | None = None  #: Pose of the tracked body in RB, if the source gives it.
    selected_by: tuple[str, ...] = ()  #: Settings that select these poses in place of the topic of true poses.

    def where(self, kept: Mask | IntArray) -> RecordedTruth:
        """Return the poses that a mask `(N,)` selects, or those of rows `(M,)` in the order of the rows."""
        poses = self.poses
        selected = replace(
            poses, stamps_ns=poses.stamps_ns[kept], positions=poses.positions[kept], quats_xyzw=poses.quats_xyzw[kept]
        )
        return replace(self, poses=selected, variances=None if self.variances is None else self.variances[kept])

    def without_attitudes(self) -> RecordedTruth:
        """Return the positions alone."""
        return replace(self, poses=replace(self.poses, quats_xyzw=np.zeros_like(self.poses.quats_xyzw)))
