"""Errors of a map against true points: by range, against loops, consistency of sigma, and coverage."""

import json
import math
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from helpers.map_scenes import RIG, cloud_of, points_of, wall
from sfr_loc_map.errors import ConfigError, MetricsError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.metrics.config import MapScoreConfig
from sfr_loc_map.metrics.figures.row_part import POINTS
from sfr_loc_map.metrics.map.cloud_frame import frame_problem
from sfr_loc_map.metrics.map.map_score import score_map, score_nearest
from sfr_loc_map.metrics.map.pair_truth import PairTruth
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_plain

CONFIG = MapScoreConfig()


def scored(cloud: PointCloud, truths: list[PairTruth]) -> Score:
    found = score_map(cloud, truths, CONFIG)
    return Score(figures=found.figures, cloud=found.cloud)


RANGES = ("0-4 m", "4-10 m", "10-20 m", "20-40 m")


@pytest.mark.clause("4.3.4")
def test_a_perfect_cloud_and_one_of_the_near_pair_alone() -> None:
    near, far = wall(3.0), wall(30.0)
    cloud = cloud_of([near, far])
    got, points = scored(cloud, [near, far]), 2 * 36 * 64
    assert (got.number("coverage"), got.number("points"), got.cloud.nearest_only) == (1.0, points, False)
    row = got.figure("point_error")
    assert (row.clause, row.part, row.n, row.mean_plus_3sigma) == ("4.3.4", None, points, 0.0)
    got = scored(cloud.select(cloud.pair == 0), [near, far])
    assert got.number("coverage") == 1.0
    assert [got.number("coverage", part=part) for part in RANGES] == [1.0, None, None, 0.0]
    assert got.number("pairs_without_cloud", part="count") == 1


def test_a_fused_cloud_is_scored_without_ranges() -> None:
    truths = [wall(3.0)]
    fused = replace(cloud_of(truths), fused=True)
    found = score_map(fused, truths, replace(CONFIG, range_edges_m=()))
    assert Score(figures=found.figures).number("coverage") == 1.0


@pytest.mark.parametrize("edges_m", [(0.0, 4.0, 2.0), (0.0, 4.0, 4.0), (0.0, 4.0, 0.0, 4.0)])
def test_edges_of_ranges_that_do_not_ascend_are_refused(edges_m: tuple[float, ...]) -> None:
    with pytest.raises(ConfigError, match="do not ascend"):
        MapScoreConfig(range_edges_m=edges_m)


def test_pairs_of_the_same_stamp_count_as_one_pair() -> None:
    truths = [wall(3.0)] * 3
    for stamps, absent, repeated in (((1, 2, 3), 0.0, 0.0), ((1, 1, 1), 2.0, 2.0 * 36 * 64)):
        got = scored(replace(cloud_of(truths), pair_stamps_ns=stamps), truths)
        counts = [got.number(name, part="count") for name in ("pairs_without_cloud", "points_repeated")]
        assert counts == [absent, repeated]


@pytest.mark.clause("4.3.4")
def test_agrees_with_loops_on_random_clouds() -> None:
    rng = np.random.default_rng(5)
    truths = [wall(3.0), wall(12.0)]
    count = 700
    u, v, pairs = (rng.integers(0, top, count) for top in (RIG.width, RIG.height, 2))
    cloud = points_of(rng.normal(0, 3, (count, 3)), rng.uniform(0.01, 1, count), u, v, pairs)
    errors, bins, pixels = [], {(0.0, 4.0): [], (4.0, 10.0): [], (10.0, 20.0): [], (20.0, 40.0): []}, set()
    for k in range(count):
        pair, u, v = int(cloud.pair[k]), int(cloud.u[k]), int(cloud.v[k])
        true = truths[pair].points[v, u].tolist()
        pixels.add((pair, u, v))
        if math.isnan(true[0]):
            continue
        errors.append(math.dist(true, cloud.xyz[k].tolist()))
        for low, high in bins:
            if low <= math.dist(true, truths[pair].T_lm_left.translation) < high:
                bins[low, high].append(errors[-1])
    seen = {
        (pair, u, v)
        for pair, truth in enumerate(truths)
        for v in range(RIG.height)
        for u in range(RIG.width)
        if math.dist(truth.points[v, u].tolist(), truth.T_lm_left.translation) < 10.0  # NaN is not
    }
    got = scored(cloud, truths)
    assert got.number("coverage") == pytest.approx(len(seen & pixels) / len(seen), abs=1e-12)
    assert got.number("points_without_truth", part="count") == count - len(errors)
    for part, values in [(None, errors), *zip(RANGES, bins.values(), strict=True)]:
        figure = got.figure("point_error", part=part)
        assert figure.n == len(values)
        if len(values) > 1:
            mean = sum(values) / len(values)
            sigma = math.sqrt(sum((x - mean) ** 2 for x in values) / (len(values) - 1))
            assert figure.mean == pytest.approx(mean, abs=1e-9)
            assert figure.mean_plus_3sigma == pytest.approx(mean + 3 * sigma, abs=1e-9)


def test_disparity_error_is_the_triangulation_law() -> None:
    """A wall at 5 m seen at 5.5 m: f b (1/5.5 - 1/5) pixels."""
    truth = wall(5.0)
    got = scored(cloud_of([truth], stretch=1.1), [truth]).figure("disparity_error")
    assert got.mean == pytest.approx(60.0 * 0.2 * (1 / 5.5 - 1 / 5.0), abs=1e-5)
    assert got.sigma == pytest.approx(0.0, abs=1e-5)


def test_footprint_coverage_by_loops() -> None:
    truth = wall(5.0)
    cloud = cloud_of([truth], keep=0.1)
    shifted = replace(cloud, xyz=cloud.xyz + np.float32(0.07), fused=True)
    have = total = 0
    points = shifted.xyz.astype(float)
    for true in truth.points.reshape(-1, 3).astype(float):
        if np.isfinite(true).all():
            total += 1
            have += np.sqrt(((points - true) ** 2).sum(axis=1)).min() < 2 * true[2] / 60.0
    assert scored(shifted, [truth]).number("coverage") == pytest.approx(have / total)
    assert 0 < have < total


def test_sigma_that_is_right_is_found_consistent_and_a_small_one_not() -> None:
    rng = np.random.default_rng(3)
    rig = type(RIG)(640, 480, 600.0, 600.0, 319.5, 239.5, 0.2)
    truth = wall(5.0, rig=rig)
    cloud = cloud_of([truth])
    ray = cloud.xyz / np.linalg.norm(cloud.xyz, axis=1, keepdims=True)
    noisy = (cloud.xyz + ray * rng.normal(0, 0.05, (len(cloud), 1))).astype(np.float32)
    right, small = (
        scored(replace(cloud, xyz=noisy, sigma=sigma), [truth]).figure("nees", part=POINTS)
        for sigma in (cloud.sigma, cloud.sigma / 3)
    )
    assert right.low95 < right.mean < right.high95
    assert small.mean > small.high95


def test_a_cloud_without_pixels_has_a_figure_of_another_name_and_the_empty_one_has_none() -> None:
    truth = wall(5.0)
    found = score_nearest(cloud_of([truth]).xyz + np.float32([0, 0, 0.1]), [truth], CONFIG)
    got = Score(figures=found.figures, cloud=found.cloud)
    assert got.cloud.nearest_only
    assert got.figure("point_error") is None
    assert got.number("nearest_distance", "mean") == pytest.approx(0.1, rel=1e-3)
    records = cloud_of([wall()]).to_structured()
    records["pair"][3] = 1
    with pytest.raises(MetricsError, match="source that the cloud was made from"):
        score_map(PointCloud.from_structured(records, fused=False), [wall()], CONFIG)
    empty = scored(PointCloud.empty(fused=False), [wall()])
    assert empty.number("coverage") == 0.0
    assert empty.number("point_error", "mean") is None
    assert "NaN" not in json.dumps(to_plain(empty))


FRAMES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "as it is": (lambda xyz: xyz, ""),
    "noisy": (lambda xyz: xyz + np.random.default_rng(0).normal(0.0, 0.3, xyz.shape), ""),
    "millimetres": (lambda xyz: 1000.0 * xyz, "if its unit is millimetres"),
    "feet": (lambda xyz: xyz / 0.3048, "if its unit is feet"),
    "optical axes": (lambda xyz: np.stack((-xyz[:, 1], -xyz[:, 2], xyz[:, 0]), axis=1), "LM are its z, -x, -y"),
    "mirrored": (lambda xyz: xyz * [1.0, -1.0, 1.0], "LM are its x, -y, z"),
    "shifted": (lambda xyz: xyz + np.array([6.9e5, 5.3e6, 500.0]), "in another frame or unit, or shifted"),
}


@pytest.mark.parametrize("case", FRAMES)
def test_a_cloud_without_pixels_in_another_unit_or_frame_is_reported(case: str) -> None:
    change, words = FRAMES[case]
    rng = np.random.default_rng(4)
    x, y = rng.uniform(2.0, 12.0, 4000), rng.uniform(-3.0, 4.0, 4000)
    true = np.column_stack((x, y, 0.2 * x + np.sin(y) - 1.0))
    tree = cKDTree(true)
    found = frame_problem(change(true[::3]), true, lambda points: np.asarray(tree.query(points)[0]))
    assert (words in found) if words else not found


@pytest.mark.clause("4.3.4")
def test_a_bound_belongs_to_the_farther_range_and_what_is_beyond_all_counts_in_the_whole() -> None:
    """True points at exactly 4, 10 and 50 m, and one nearer than all bounds."""
    points = np.full((RIG.height, RIG.width, 3), np.nan, np.float32)
    depths = {5: 1.0, 6: 4.0, 7: 10.0, 8: 50.0}
    for u, depth in depths.items():
        points[20, u] = (0.0, 0.0, depth)
    truth = PairTruth(points, wall().T_lm_left, RIG)
    u = np.array(list(depths))
    found = points_of(points[20, u] + np.float32([0.0, 0.0, 0.5]), 0.1, u, np.full(4, 20), 0)
    got = scored(found, [truth])
    assert got.figure("point_error", part=None).n == 4
    assert [got.figure("point_error", part=part).n for part in RANGES] == [1, 1, 1, 0]
    assert [got.figure("coverage", part=part).n for part in RANGES] == [1, 1, 1, 0]
    assert got.figure("coverage", part=None).n == 2, "from 0 to less than 10 m"
    assert got.number("point_error", "mean", part="4-10 m") == pytest.approx(0.5)


def test_robust_figures_of_heights_are_those_of_normal_errors_and_ignore_gross_ones() -> None:
    """Height errors of 0.1 m with a bias, one in fifty gross: NMAD is their sigma, LE90 and CE90 the quantiles."""
    rng = np.random.default_rng(8)
    truths = [wall(3.0)]
    v, u = (index.ravel() for index in np.indices((RIG.height, RIG.width)))
    seen = np.isfinite(truths[0].points[v, u]).all(axis=1)
    v, u = v[seen], u[seen]
    true = truths[0].points[v, u].astype(np.float64)
    offset = rng.normal(0.0, 0.1, (len(u), 3))
    offset[:, 2] += 0.2
    offset[::50, 2] += 5.0
    cloud = points_of(true + offset, np.full(len(u), 0.1), u, v, np.zeros(len(u), int))
    got = scored(cloud, truths)
    assert got.number("nmad") == pytest.approx(0.1, rel=0.08)
    heights, across = offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])
    assert got.number("le90") == pytest.approx(np.quantile(np.abs(heights), 0.9), rel=1e-4)
    assert got.number("ce90") == pytest.approx(np.quantile(across, 0.9), rel=1e-4)
    assert got.figure("point_error").sigma > 0.5, "sigma itself is that of the gross errors"


def test_a_point_behind_the_camera_has_an_error_and_an_unknown_disparity() -> None:
    truth = wall()
    cloud = cloud_of([truth])
    cloud.xyz[0] = -cloud.xyz[0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        score = Score(figures=score_map(cloud, [truth], MapScoreConfig()).figures)
    points, disparity = (score.figure(name, part=None) for name in ("point_error", "disparity_error"))
    assert points.max == pytest.approx(2.0 * float(np.linalg.norm(cloud.xyz[0])))
    assert (disparity.n, disparity.unknown, disparity.mean) == (points.n - 1, 1, None)


def test_a_map_without_truth_or_with_unknown_coordinates_is_refused() -> None:
    cloud = cloud_of([wall()])
    for score in (
        lambda: score_map(replace(cloud, fused=False), [], MapScoreConfig()),
        lambda: score_nearest(cloud.xyz, [], MapScoreConfig()),
    ):
        with pytest.raises(MetricsError, match="requires the truth of at least one pair"):
            score()
    cloud.xyz[3] = np.nan
    with pytest.raises(MetricsError, match="not finite"):
        score_nearest(cloud.xyz, [wall()], MapScoreConfig())


@pytest.mark.parametrize("stamps_ns", [(), (10,)])
def test_a_cloud_with_fewer_stamps_than_pairs_is_refused(stamps_ns: tuple[int, ...]) -> None:
    truths = [wall(), wall()]
    cloud = replace(cloud_of(truths), fused=False, pair_stamps_ns=stamps_ns)
    with pytest.raises(MetricsError, match=f"points of pair 1 .* stamps for only {len(stamps_ns)} pair"):
        score_map(cloud, truths, CONFIG)


def test_a_true_point_at_the_optical_centre_has_an_error_but_no_ray() -> None:
    truth = wall()
    truth.points[20, 20] = 0.0
    cloud = replace(cloud_of([truth]), fused=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        score = Score(figures=score_map(cloud, [truth], CONFIG).figures)
    assert np.isfinite(score.number("nees", "mean", part=POINTS))
    assert score.figure("point_error", part=None).n == len(cloud)


def test_points_without_any_true_point_are_not_repeated() -> None:
    truth = wall()
    truth.points[:] = np.nan
    found = score_nearest(cloud_of([wall()]).xyz, [truth], CONFIG)
    assert Score(figures=found.figures).number("points_repeated") == 0.0
