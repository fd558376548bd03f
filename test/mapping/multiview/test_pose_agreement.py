"""Agreement of views: correct sigmas give a ratio of 1, wrong ones are named."""

from dataclasses import replace

import numpy as np
import pytest

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.multiview.pose_agreement import MIN_OVERLAP, PoseAgreement
from sfr_loc_map.mapping.multiview.view import View
from sfr_loc_map.mapping.multiview.view_reprojection import ReprojectedPoints

F = np.float32
COUNT, SEEN = 40_000, 20_000
RNG = np.random.default_rng(0)


def view_with(sigma: float) -> View:
    columns = np.full(COUNT, sigma, F), np.zeros(COUNT, F), np.zeros(COUNT, np.uint16), np.zeros(COUNT, np.uint16)
    cloud = PointCloud(np.zeros((COUNT, 3), F), *columns, np.zeros(COUNT, np.uint8))
    return View(cloud, np.zeros((10, 10), F), Transform.identity(), 2.0)


def points(spread: float, grey: float = 3.0, shifted: float = 15.0, seen: int = SEEN) -> ReprojectedPoints:
    """Return points that differ by a normal distribution around 1 mm, as seen with a sigma of 4 cm."""
    difference = RNG.normal(0.001, spread, seen).astype(F)
    grey_difference, beside = (RNG.normal(7.0, s, seen).astype(F) for s in (grey, shifted))
    deviation = np.full(seen, 0.04, F)
    return ReprojectedPoints(np.arange(seen), difference, deviation, deviation, grey_difference, beside, deviation)


def measured(pairs: tuple[int, int], found: ReprojectedPoints) -> PoseAgreement:
    return PoseAgreement.measure(pairs, (view_with(0.03), view_with(0.04)), found)


def test_correct_sigmas_give_a_ratio_of_one() -> None:
    """The variances of both views add up: 3 cm and 4 cm make 5 cm."""
    agreement = measured((0, 1), points(0.05))
    assert agreement.range_ratio == pytest.approx(1.0, abs=0.03)
    assert agreement.overlap == 0.5
    assert agreement.median_m == pytest.approx(0.001, abs=0.003)
    assert agreement.spread_m == pytest.approx(0.05, rel=0.04)
    assert agreement.grey_ratio == pytest.approx(0.2, rel=0.05)
    assert agreement.warnings() == ()
    assert set(agreement.statistics()) == {
        "overlap_0_1",
        "difference_median_m_0_1",
        "difference_spread_m_0_1",
        "difference_over_sigma_0_1",
        "grey_difference_over_beside_0_1",
    }


@pytest.mark.parametrize(
    "found", [points(0.15), points(0.05, grey=9.0)], ids=["ranges three times as far apart", "other grey levels"]
)
def test_disagreement_is_named_once(found: ReprojectedPoints) -> None:
    (line,) = measured((0, 1), found).warnings()
    assert "pairs 0 and 1 disagree" in line
    assert measured((1, 0), found).warnings() == ()


def test_small_overlap_says_nothing_of_poses() -> None:
    assert measured((0, 1), points(0.5, seen=MIN_OVERLAP)).warnings() == ()
    nothing = measured((0, 2), points(0.05, seen=0))
    assert nothing.statistics() == {"overlap_0_2": 0.0}
    assert nothing.warnings() == ()


def test_grey_levels_say_nothing_without_texture() -> None:
    agreement = measured((0, 1), points(0.05, grey=3.0, shifted=3.5))
    assert np.isnan(agreement.grey_ratio)
    assert agreement.warnings() == ()
    assert replace(agreement, grey_ratio=0.9).warnings()
