"""The disparities that are searched and kept, from the range of depths."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import DISPARITY_STEP

MAX_DISPARITY_FRACTION = 0.5
"""Largest disparity that is searched, as a fraction of the image's width: most of a nearer surface is visible to one
camera only."""


@dataclass(frozen=True, slots=True)
class SearchRange:
    """Disparities that are searched and kept, pixels."""

    min_disparity_px: float  #: Disparity of the farthest depth that is kept; smaller ones are searched, not kept.
    #: Smallest upper limit of the search: the disparity of `min_range_m` or half the width. The search is rounded up
    #: from it, and larger disparities that are found are kept.
    max_disparity_px: float
    #: Smallest number of whole disparities that are searched from 0 on, a multiple of `DISPARITY_STEP`. In wide images
    #: it is rounded up to a multiple of twice that (`semi_global_matching`).
    count: int


def search_range(rig: StereoRig, config: MappingConfig) -> SearchRange:
    """Return the disparities between the farthest and the nearest depth, `d = fx baseline / Z`.

    If `MAX_DISPARITY_FRACTION` of the width is less than the disparity of `min_range_m`, surfaces at `min_range_m` may
    not be found.
    """
    if config.min_range_m >= config.max_range_m:
        raise ConfigError(
            f"min_range_m {config.min_range_m} must be less than max_range_m {config.max_range_m}: correct them"
        )
    scale = rig.fx * rig.baseline_m
    max_disparity_px = min(scale / config.min_range_m, MAX_DISPARITY_FRACTION * rig.width)
    min_disparity_px = scale / config.max_range_m
    if min_disparity_px >= max_disparity_px:
        raise ConfigError(
            f"at max_range_m {config.max_range_m} the disparity is {min_disparity_px:.4g} px, half the image has "
            f"{max_disparity_px:.4g}: nothing can be matched; correct the ranges or the baseline"
        )
    count = DISPARITY_STEP * math.ceil((max_disparity_px + 1.0) / DISPARITY_STEP)
    return SearchRange(min_disparity_px, max_disparity_px, count)
