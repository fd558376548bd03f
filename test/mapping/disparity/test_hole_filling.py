"""Holes in a scene of two planes whose truth is known: which take a surface, and which stay empty."""

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.hole_filling import MAX_DEPTH_RATIO, Filled, distance_to, fill_holes
from sfr_loc_map.mapping.disparity.partner_claims import MIN_ALIKE, confirmed, right_claims
from sfr_loc_map.mapping.disparity.surface_hypotheses import REACH, Field, Images, Plane, hypotheses, plane_cost
from sfr_loc_map.mapping.disparity.validity import support_weights

F = np.float32
ROWS, COLS = 60, 160
NEAR, FAR = 14.0, 6.0
BLOCK = np.s_[15:45, 70:120]
OCCLUDED = np.s_[15:45, 62:70]
NOISE = 2.0


class Scene:
    """A block before a background, seen by both cameras, with noise."""

    def __init__(self, texture: float = 1.0, far: float = FAR) -> None:
        rng = np.random.default_rng(0)
        background = 128.0 + texture * rng.integers(-100, 100, (ROWS, COLS + 40))
        block = 128.0 + texture * rng.integers(-100, 100, (30, 50))
        left, right = background[:, :COLS].copy(), background[:, int(far) : COLS + int(far)].copy()
        left[BLOCK] = block
        right[15:45, 70 - int(NEAR) : 120 - int(NEAR)] = block
        self.left, self.right = (np.rint(i + rng.normal(0.0, NOISE, i.shape)).astype(F) for i in (left, right))
        self.truth = np.full((ROWS, COLS), far, F)
        self.truth[BLOCK] = NEAR
        self.visible = np.ones((ROWS, COLS), bool)
        self.visible[OCCLUDED] = False
        self.visible[:, : int(far)] = False

    def images(self) -> Images:
        return Images(self.left, self.right, *support_weights())

    def filled(self, hole: np.ndarray, may: np.ndarray | None = None) -> Filled:
        """Return what is filled of a hole in which nothing was matched."""
        valid = self.visible & ~hole
        disparity, matched = np.where(valid, self.truth, F(0.0)), np.where(valid, self.truth, F(np.nan))
        return fill_holes(self.images(), disparity, valid, matched, NOISE, np.ones_like(valid) if may is None else may)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene()


def beside_edge() -> np.ndarray:
    """Return a hole on both sides of the block's right edge."""
    hole = np.zeros((ROWS, COLS), bool)
    hole[18:42, 115:126] = True
    return hole


def test_pixels_beside_an_edge_take_their_own_surface(scene: Scene) -> None:
    hole = beside_edge()
    found = scene.filled(hole)
    assert found.filled[hole].mean() > 0.9
    np.testing.assert_allclose(found.disparity[found.filled], scene.truth[found.filled], atol=0.01)


def test_what_is_far_behind_another_surface_stays_empty() -> None:
    """One pixel of near ground with the depth of what lies behind a rim would be most of a map's error."""
    scene, hole = Scene(far=3.0), beside_edge()
    found = scene.filled(hole)
    assert NEAR > MAX_DEPTH_RATIO * 3.0
    assert found.filled[18:42, 115:120].mean() > 0.9
    assert not found.filled[:, 120:].any()


def test_what_the_right_camera_does_not_see_stays_empty(scene: Scene) -> None:
    found = scene.filled(np.zeros((ROWS, COLS), bool))
    assert found.filled[OCCLUDED].mean() < 0.02
    assert not found.filled[:, : int(FAR)].any()


def test_only_what_may_be_filled_is(scene: Scene) -> None:
    hole = beside_edge()
    may = np.ones_like(hole)
    may[:, 120:] = False
    filled = scene.filled(hole, may).filled
    assert filled[18:42, 115:120].mean() > 0.8
    assert not filled[:, 120:].any()


def test_a_textureless_region_is_no_part_of_the_surface_beside_it_unless_enclosed() -> None:
    """Noise matches every surface; what a surface encloses is its own."""
    scene = Scene()
    rng = np.random.default_rng(1)
    sky, patch = np.s_[:14], np.s_[50:56, 60:66]
    for image in (scene.left, scene.right):
        image[sky] = np.rint(rng.normal(128.0, NOISE, image[sky].shape))
        image[50:56, 45:66] = np.rint(rng.normal(128.0, NOISE, (6, 21)))
    hole = np.zeros((ROWS, COLS), bool)
    hole[sky] = hole[patch] = True
    filled = scene.filled(hole).filled
    assert filled[:12].mean() < 0.1
    assert filled[patch].mean() > 0.8


def test_surfaces_are_continued_as_planes() -> None:
    v, u = np.mgrid[:ROWS, :COLS]
    plane = (10.0 + 0.2 * u - 0.1 * v).astype(F)
    valid = np.ones((ROWS, COLS), bool)
    valid[20:31, 60:71] = False
    field = Field(np.where(valid, plane, F(0.0)), valid, ~valid, plane, distance_to(valid))
    found = hypotheses(field, 25, 65)
    np.testing.assert_allclose(found, np.tile([plane[25, 65], 0.2, -0.1], (8, 1)), atol=1e-4)
    valid[:] = False
    valid[25, 65 + REACH] = valid[25 - REACH - 1, 65] = True
    field = Field(plane, valid, ~valid, plane, distance_to(valid))
    np.testing.assert_array_equal(np.isfinite(hypotheses(field, 25, 65)[:, 0]), [True] + 7 * [False])


def test_cost_is_least_at_the_true_plane(scene: Scene) -> None:
    nothing = np.zeros((ROWS, COLS), bool)
    costs = [plane_cost(scene.images(), nothing, 30, 95, Plane(F(d), F(0.0), F(0.0)))[0] for d in (13.0, 14.0, 15.0)]
    assert costs[1] < 2.0 * NOISE
    assert min(costs[0], costs[2]) > 5.0 * NOISE
    worth = [
        plane_cost(scene.images(), np.full((ROWS, COLS), v), 30, 95, Plane(F(14.0), F(0.0), F(0.0)))[1]
        for v in (False, True)
    ]
    np.testing.assert_allclose(worth[0], worth[1], rtol=1e-5)
    beyond = plane_cost(scene.images(), nothing, 30, 10, Plane(F(40.0), F(0.0), F(0.0)))
    assert beyond[0] > 1e6


def test_claims_and_single_pixels() -> None:
    disparity, known = np.full((9, 40), FAR, F), np.ones((9, 40), bool)
    disparity[4, 20] = NEAR
    claims = right_claims(disparity, known)
    assert (claims.low[4, 14], claims.high[4, 14]) == (np.float32(1e9), np.float32(-1e9))
    assert (claims.low[4, 6], claims.high[4, 6]) == (FAR, NEAR)
    kept = confirmed(disparity, known, known, claims)
    assert not kept[4, 20]
    assert not kept[4, 12]
    assert not kept[:, : int(FAR)].any()
    assert kept[3, 20]
    known[5] = known[4, 30] = False
    alone = confirmed(disparity, known, known, right_claims(disparity, known))
    assert not alone[4, 31]
    assert MIN_ALIKE == 5


def test_too_few_matches_fill_nothing(scene: Scene) -> None:
    hole = np.ones((ROWS, COLS), bool)
    hole[30:33, 90:93] = False
    assert not scene.filled(hole).filled.any()
