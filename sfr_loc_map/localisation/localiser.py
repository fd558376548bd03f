"""The localiser: one call per stereo pair."""

from __future__ import annotations

from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate


class Localiser:
    """Estimates the pose of RB in DS at each stereo pair."""

    def __init__(self, rig: StereoRig, config: LocalisationConfig, T_ds_rb: Transform) -> None:
        """Start at a given pose.

        Args:
            rig: Rectified rig with its place on the rover.
            config: Parameters.
            T_ds_rb: Pose of RB in DS at the first pair.

        Raises:
            GeometryError: If the rig's place on the rover is not known.
        """

    def warm_up(self) -> None:
        """Load or compile all machine code, so that no call pays for it; the state does not change."""

    def process(self, pair: StereoPair) -> PoseEstimate:
        """Return the pose at one pair; pairs come in the order of their stamps.

        Raises:
            LocalisationError: If the pair does not have the rig's size.
        """
        raise NotImplementedError

    def set_pose(self, T_ds_rb: Transform) -> None:
        """Let the next estimate start at this pose."""
        raise NotImplementedError

    def reset(self, T_ds_rb: Transform) -> None:
        """Forget everything and start anew at this pose."""
        raise NotImplementedError
