"""The disparities that are searched and kept, from the configured depths."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import DISPARITY_STEP

MAX_DISPARITY_FRACTION = 0.5
"""Maximum disparity of the search as a fraction of the image width. Most of a nearer surface is visible to only one
camera."""


@dataclass(frozen=True, slots=True)
class SearchRange:
    """Disparities that are searched and kept, pixels."""

    min_disparity_px: float  #: Disparity at `max_range_m`; smaller disparities are searched but not kept.
    #: Limit that the search must reach: the smaller of the disparity at `min_range_m` and half the image width. Larger
    #: disparities that are found are kept. In ROS, `stereo_msgs/DisparityImage` states this limit.
    max_disparity_px: float
    #: Number of searched integer disparities from 0 on: the smallest multiple of `DISPARITY_STEP` that includes the
    #: limit. Wide images are matched at half their width (`semi_global_matching`). The matcher then searches only even
    #: disparities and may miss the limit by up to one pixel.
    count: int


def search_range_of(rig: StereoRig, config: MappingConfig) -> SearchRange:
    """Return the disparities between the maximum and the minimum depth, `d = fx baseline / Z`.

    Surfaces at `min_range_m` may not be found if their disparity exceeds `MAX_DISPARITY_FRACTION` of the image width.
    Raises ConfigError if the range of disparities is empty.
    """
    if config.min_range_m >= config.max_range_m:
        raise ConfigError(
            f"min_range_m is {config.min_range_m}: a number below max_range_m, {config.max_range_m}, is required"
        )
    scale = rig.fx * rig.baseline_m
    max_disparity_px = min(scale / config.min_range_m, MAX_DISPARITY_FRACTION * rig.width)
    min_disparity_px = scale / config.max_range_m
    if min_disparity_px >= max_disparity_px:
        raise ConfigError(
            f"at max_range_m {config.max_range_m} the disparity is {min_disparity_px:.4g} px, but the search ends at "
            f"half the image width, {max_disparity_px:.4g} px: nothing can be matched; correct the ranges or the "
            "baseline"
        )
    count = DISPARITY_STEP * math.ceil((max_disparity_px + 1.0) / DISPARITY_STEP)
    return SearchRange(min_disparity_px, max_disparity_px, count)
