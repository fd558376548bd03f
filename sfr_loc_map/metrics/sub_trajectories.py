"""The sub-trajectories of a condition, whose errors are the figures of the trajectory [4.1]."""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.metrics import formulas, other_formulas
from sfr_loc_map.metrics.formulas import Poses, SubTrajectoryErrors


class SubTrajectories(NamedTuple):
    """The sub-trajectories of one condition, and their errors by one reading of the specification."""

    starts: IntArray  #: Frames N.
    ends: IntArray  #: Frames N+x.
    poses: Poses  #: Poses of all frames.
    errors: SubTrajectoryErrors

    def where(self, chosen: Mask | slice) -> SubTrajectories:
        """Return the chosen sub-trajectories."""
        errors = SubTrajectoryErrors(*(values[chosen] for values in self.errors))
        return self._replace(starts=self.starts[chosen], ends=self.ends[chosen], errors=errors)

    def true_displacement(self) -> FloatArray:
        """Return the true displacements from N to N+x."""
        return formulas.displacement(self.poses.true_position, self.starts, self.ends)

    def by_direction(self) -> dict[str, FloatArray]:
        """Return the position errors along x, y and z of DS, and along and across the true displacement."""
        x, y, z = self.errors.position_m.T
        true_heading = formulas.heading(self.poses.true_attitude[self.ends])
        along, cross = other_formulas.along_and_cross(self.errors.position_m, self.true_displacement(), true_heading)
        return {"x": x, "y": y, "z": z, "along": along, "cross": cross}
