"""Holes in a scene of two planes whose truth is known: which take a surface, and which stay empty."""

import numpy as np

from helpers.disparity_world import two_planes
from sfr_loc_map.mapping.disparity.hole_filling import MAX_DEPTH_RATIO, MIN_FILLED_SIGMA_PX, fill_holes
from sfr_loc_map.mapping.disparity.surfaces import DisparityScene

F = np.float32
ROWS, COLS = 60, 160
NEAR, FAR = 14.0, 6.0
BLOCK = np.s_[15:45, 70:120]
OCCLUDED = np.s_[15:45, 62:70]
NOISE = 2.0


class TwoPlanes:
    def __init__(self, far: float = FAR, noise: float = NOISE) -> None:
        left, right, self.truth = two_planes((ROWS, COLS), BLOCK, int(NEAR), int(far), noise)
        self.noise = noise
        self.left, self.right = left.astype(F), right.astype(F)
        self.visible = np.ones((ROWS, COLS), bool)
        self.visible[OCCLUDED] = False
        self.visible[:, : int(far)] = False

    def filled(self, hole: np.ndarray, may: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return what is filled of a hole in which nothing was matched."""
        valid = self.visible & ~hole
        disparity, matched = np.where(valid, self.truth, F(0.0)), np.where(valid, self.truth, F(np.nan))
        saturated = np.zeros(valid.shape, bool) if may is None else ~may
        given = DisparityScene(
            left=self.left,
            right=self.right,
            matched=matched,
            disparity=disparity,
            sigma=np.full_like(disparity, 0.1),
            valid=valid,
        )
        found = fill_holes(given, saturated, self.noise)
        filled = found.valid & ~valid
        assert (found.valid | ~valid).all()
        assert (found.sigma[filled] >= MIN_FILLED_SIGMA_PX).all()
        np.testing.assert_array_equal(found.sigma[~filled], given.sigma[~filled])
        return found.disparity, filled


def test_pixels_beside_an_edge_take_their_own_surface_but_not_far_behind_another() -> None:
    """One pixel of near ground with the depth of what lies behind a rim would be most of a map's error."""
    scene, hole = TwoPlanes(), np.zeros((ROWS, COLS), bool)
    hole[18:42, 115:126] = True  # on both sides of the block's right edge
    disparity, filled = scene.filled(hole)
    assert filled[hole].mean() > 0.9
    np.testing.assert_allclose(disparity[filled], scene.truth[filled], atol=0.01)
    may = np.ones_like(hole)
    may[:, 120:] = False
    assert not scene.filled(hole, may)[1][:, 120:].any()
    _, filled = TwoPlanes(far=3.0).filled(hole)
    assert NEAR > MAX_DEPTH_RATIO * 3.0
    assert filled[18:42, 115:120].mean() > 0.9
    assert not filled[:, 120:].any()


def test_what_the_right_camera_does_not_see_or_little_is_known_of_stays_empty() -> None:
    scene = TwoPlanes()
    _, filled = scene.filled(np.zeros((ROWS, COLS), bool))
    assert filled[OCCLUDED].mean() < 0.02
    assert not filled[:, : int(FAR)].any()
    hole = np.ones((ROWS, COLS), bool)
    hole[30:33, 90:93] = False
    assert not scene.filled(hole)[1].any()


def test_holes_of_a_pair_that_matches_perfectly_are_filled() -> None:
    """The cost of the valid pixels is 0 there, and so is the largest cost of a filled one."""
    scene = TwoPlanes(far=NEAR, noise=0.0)
    hole = np.zeros((ROWS, COLS), bool)
    hole[20:26, 100:106] = True
    disparity, filled = scene.filled(hole)
    assert filled[hole].all()
    np.testing.assert_array_equal(disparity[hole], scene.truth[hole])
