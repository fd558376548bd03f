"""Accuracy of disparities, against hand-made images and against the suite's own map score."""

from __future__ import annotations

import numpy as np
import pytest
from made_scene import NAV_RIG, nav_pair

from sfr_loc_map.bench.disparity_accuracy import TrueDisparity, disparity_accuracy, visible_in_both
from sfr_loc_map.bench.mapping_benchmark import true_disparity
from sfr_loc_map.mapping.reprojection import cloud_from_disparity
from sfr_loc_map.metrics.cloud_error import PairTruth, score_map
from sfr_loc_map.metrics.config import MapScoreConfig


def test_a_box_before_a_wall_hides_as_much_as_it_stands_out() -> None:
    truth = np.full((3, 40), 4.0)
    truth[:, 20:30] = 10.0
    seen = visible_in_both(truth)
    # the first four columns have no partner; the box covers columns 10-19 of the right image, there the wall of 14-23
    assert np.flatnonzero(~seen[1]).tolist() == [0, 1, 2, 3, 14, 15, 16, 17, 18, 19]


def test_slanted_ground_hides_nothing() -> None:
    truth = np.tile(12.0 - 0.3 * np.arange(40), (2, 1)) + 0.5
    inside = np.arange(40) - truth[0] >= 0
    np.testing.assert_array_equal(visible_in_both(np.where(truth > 0, truth, np.nan))[0], inside & (truth[0] > 0))


def test_figures_of_known_errors() -> None:
    true = np.full((10, 100), 5.0)
    truth = TrueDisparity(true, np.ones(true.shape, np.bool_))
    found = true.astype(np.float32)
    found[0] = np.nan
    found[1:] += np.float32(0.25)
    found[1, :18] += np.float32(1.25)
    found[2, :9] += np.float32(4.0)
    accuracy = disparity_accuracy([found], [truth], NAV_RIG_10)
    assert accuracy.density == pytest.approx(0.9)
    assert accuracy.errors is not None
    assert accuracy.errors.bad_1 == pytest.approx(27 / 900)
    assert accuracy.errors.bad_2 == pytest.approx(9 / 900)
    assert accuracy.errors.bias_px == pytest.approx(0.25)
    assert accuracy.errors.sigma_px == 0.0
    assert accuracy.errors.mean_abs_px == pytest.approx(0.25 + (18 * 1.25 + 9 * 4.0) / 900)


NAV_RIG_10 = type(NAV_RIG)(100, 10, 150.0, 150.0, 49.5, 4.5, 0.12)


def test_spread_is_that_of_a_normal_law() -> None:
    true = np.full((400, 500), 50.0)
    error = np.random.default_rng(3).normal(0.1, 0.3, true.shape)
    truth = TrueDisparity(true, np.ones(true.shape, np.bool_))
    rig = type(NAV_RIG)(500, 400, 150.0, 150.0, 250.0, 200.0, 0.12)
    accuracy = disparity_accuracy([(true + error).astype(np.float32)], [truth], rig)
    assert accuracy.errors is not None
    assert accuracy.errors.sigma_px == pytest.approx(0.3, rel=0.01)
    assert accuracy.errors.bias_px == pytest.approx(0.1, abs=0.005)


def test_nothing_found_has_no_errors() -> None:
    truth = true_disparity(nav_pair(0), NAV_RIG, 0)
    assert truth is not None
    accuracy = disparity_accuracy([np.full((120, 160), np.nan, np.float32)], [truth], NAV_RIG)
    assert accuracy.density == 0.0
    assert accuracy.coverage == 0.0
    assert accuracy.errors is None
    assert "bad_1" not in accuracy.to_json()


def test_point_errors_and_coverage_are_those_of_the_map_score() -> None:
    item = nav_pair(1)
    truth = true_disparity(item, NAV_RIG, 0)
    assert truth is not None
    found = (truth.disparity_px + np.random.default_rng(2).normal(0, 0.4, (120, 160))).astype(np.float32)
    found[::7] = np.nan
    accuracy = disparity_accuracy([found], [truth], NAV_RIG)
    sigma = np.ones_like(found)
    cloud = cloud_from_disparity(found, sigma, item.pair.left, NAV_RIG, item.T_lm_navsb @ NAV_RIG.T_sb_left, 0)
    pair_truth = PairTruth.of(item, NAV_RIG)
    assert pair_truth is not None
    score = score_map(cloud, [pair_truth], MapScoreConfig()).score
    assert accuracy.coverage == pytest.approx(score.coverage, abs=1e-9)
    assert score.errors is not None
    for row in score.errors.by_range:
        mine, error = accuracy.by_range_m[f"{row.from_m:g}-{row.to_m:g} m"], row.point_error_m
        assert mine.count == pytest.approx(error.count, abs=3)
        if error.count:
            assert mine.mean == pytest.approx(error.mean, rel=1e-3)
            assert mine.mean_plus_3sigma == pytest.approx(error.mean_plus_3sigma, rel=1e-3)
