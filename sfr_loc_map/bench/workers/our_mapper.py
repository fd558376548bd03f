"""Our mapper as a reference method."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from sfr_loc_map import __version__
from sfr_loc_map.config import build
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper, PairMap

CAMERA = ("width", "height", "fx", "fy", "cx", "cy", "baseline_m")


class OurMapper:
    """Disparities of the left image; the call also computes the cloud and its standard deviations."""

    version = __version__

    def __init__(self, setup: Mapping[str, Any]) -> None:
        """Prepare for the rig."""
        self._mapper = Mapper(
            StereoRig(**{name: setup[name] for name in CAMERA}), build(MappingConfig, setup["config"])
        )
        self._mapper.warm_up()

    def prepare(self, left: GreyImage, right: GreyImage, order: Mapping[str, Any]) -> Callable[[], PairMap]:
        """Return the call."""
        pair = StereoPair(order["stamp_ns"], left, right)
        return lambda: self._mapper.process(pair, Transform.identity(), 0)

    def report(self, answer: PairMap, order: Mapping[str, Any]) -> dict[str, Any]:
        """Save the disparities."""
        np.save(order["output"], answer.disparity_px)
        return {}


open_method = OurMapper
