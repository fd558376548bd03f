"""Two pairs of the same ground from the same pose, with other noise."""

from typing import NamedTuple

import numpy as np
import pytest

from helpers.disparity_world import hills, make_world
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.pair_view import PairView, ViewPoints

POSE = Transform(matrix_from_rotvec([0.0, 0.4, 0.3]), np.array([0.0, 0.0, 2.0]))
"""Of NAVSB in LM."""


class TwoViews(NamedTuple):
    """Two views of one ground and its true disparities `(H, W)`."""

    rig: StereoRig
    views: tuple[PairView, PairView]
    disparity: np.ndarray

    def depth_errors(self, points: ViewPoints) -> np.ndarray:
        """Return the errors of depth of points of either view, metres."""
        depth = self.views[0].T_lm_left.inverse().apply(points.xyz)[:, 2]
        return depth - (self.rig.fx * self.rig.baseline_m / self.disparity)[points.v, points.u]


@pytest.fixture(scope="session")
def two_views() -> TwoViews:
    """Two views of hills, 5 grey levels of noise."""
    first, second = (make_world(hills, width=384, height=320, noise=5.0, noise_seed=n) for n in (1, 2))
    mapper = Mapper(first.rig, MappingConfig())
    maps = mapper.process(first.pair, POSE, 0), mapper.process(second.pair, POSE, 1)
    views = [item.view for item in maps]
    return TwoViews(first.rig, (views[0], views[1]), first.disparity)
