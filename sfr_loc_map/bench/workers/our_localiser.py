"""Our localiser as a reference method."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from sfr_loc_map import __version__
from sfr_loc_map.config import build
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.localisation.localiser import Localiser

CAMERA = ("width", "height", "fx", "fy", "cx", "cy", "baseline_m")


class OurLocaliser:
    """Pose of the left camera in its first one."""

    version = __version__

    def __init__(self, setup: Mapping[str, Any]) -> None:
        """Prepare with the rover frame in the left camera: all methods estimate the same pose."""
        rig = StereoRig(**{name: setup[name] for name in CAMERA})
        rig = replace(rig, T_rb_sb=rig.T_sb_left.inverse())
        self._localiser = Localiser(rig, build(LocalisationConfig, setup["config"]), Transform.identity())
        self._localiser.warm_up()

    def prepare(self, left: GreyImage, right: GreyImage, order: Mapping[str, Any]) -> Callable[[], PoseEstimate]:
        """Return the call."""
        pair = StereoPair(order["stamp_ns"], left, right)
        return lambda: self._localiser.process(pair)

    def report(self, answer: PoseEstimate, order: Mapping[str, Any]) -> dict[str, Any]:
        """Return the pose as 16 numbers, None when lost."""
        known = answer.state is not TrackingState.LOST
        return {"pose": answer.T_ds_rb.matrix.ravel().tolist() if known else None}


open_method = OurLocaliser
