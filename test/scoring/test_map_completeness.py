"""How much of a map a cloud covers, by `sfr score`: points in the sky, empty pairs and repeated points are counted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.judge import SKY_ROWS, Judge
from helpers.made_scene import NAV_RIG, nav_pair, true_cloud, write_folder
from helpers.scored_drives import limits
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.io.clouds.cloud_file import load_cloud, save_cloud, save_points


@pytest.mark.clause("4.3.4")
def test_points_in_the_sky_are_a_limited_share(sfr: Sfr, judge: Judge, source: Path, cloud: Path) -> None:
    share = SKY_ROWS / NAV_RIG.height
    for part in ("map", "completeness"):
        for limit, code in ((share + 0.01, 0), (share - 0.01, 1)):
            limits = judge.limits(f"{part}:\n  points_without_truth_max_share: {limit}\n")
            result = sfr("score", cloud, source, "--limits", limits, "--json", "-")
            assert result.code == code, result.err
            assert json.loads(result.out)["verdicts"][0]["value"] == pytest.approx(share)


@pytest.mark.clause("4.3.4")
@pytest.mark.parametrize("way", ["complete", "sky", "two points", "one pair", "not finite"])
def test_a_map_is_complete_before_it_passes(judge: Judge, source: Path, cloud: Path, way: str) -> None:
    """Points named on sky pixels, two points in all, an empty pair, points that are not finite."""
    given = load_cloud(cloud).cloud
    assert given is not None
    on_surface = given.v >= SKY_ROWS
    kept = on_surface | (way == "sky")
    if way == "two points":
        kept = np.isin(np.arange(len(kept)), np.flatnonzero(on_surface)[[0, -1]])
    if way == "one pair":
        kept = on_surface & (given.pair == 0)
    xyz = given.xyz[kept].copy()
    if way == "not finite":
        xyz[::10] = np.nan
    columns = (getattr(given, name)[kept] for name in ("sigma", "intensity", "u", "v", "pair"))
    save_cloud(cloud, PointCloud(xyz, *columns, fused=False))
    report = judge.folder / "map.json"
    limits = judge.limits("map: {point_error_p95_m: 10}\n")
    result = judge.sfr("score", cloud, source, "--limits", limits, "--json", report)
    expected = (0, "pass") if way == "complete" else (3, "incomplete")
    assert (result.code, json.loads(report.read_text())["verdict"]) == expected, result.err


@pytest.mark.clause("4.3.4")
@pytest.mark.parametrize(("least", "code"), [(0.5, 3), (0.1, 0)])
def test_a_limit_on_the_coverage_of_all_pairs_accepts_only_its_own_share_of_one_pair(
    judge: Judge, source: Path, cloud: Path, least: float, code: int
) -> None:
    """One of the pairs has a tenth of its points, but the coverage of all pairs is above the limit."""
    given = load_cloud(cloud).cloud
    assert given is not None
    is_kept = (given.v >= SKY_ROWS) & ((given.pair != 1) | (given.u % 7 == 0))
    columns = (getattr(given, name)[is_kept] for name in ("xyz", "sigma", "intensity", "u", "v", "pair"))
    save_cloud(cloud, PointCloud(*columns, fused=False))
    rules = judge.limits(f"map: {{coverage_min: {least}}}\n")
    result = judge.sfr("score", cloud, source, "--limits", rules)
    assert result.code == code, result.out + result.err


def test_points_of_a_map_that_are_repeated_are_no_more_points(tmp_path: Path, sfr: Sfr) -> None:
    """A tenth of the points is 0.5 m too far away; the others, each twenty times, hide them from the 95 % quantile."""
    folder, path = write_folder(tmp_path / "nav", 0, 1), tmp_path / "cloud.ply"
    cloud = true_cloud()
    is_wrong = np.arange(len(cloud)) % 10 == 0
    cloud.xyz[is_wrong] += np.float32([0.5, 0.0, 0.0])
    rules = limits(tmp_path, {"map": {"point_error_p95_m": 0.1}})
    rows = np.flatnonzero(~is_wrong)
    records = cloud.to_structured()
    every = np.arange(len(cloud))
    for chosen, code in ((every, 1), (rows, 0), (np.append(every, np.tile(rows, 20)), 3)):
        save_cloud(path, PointCloud.from_structured(records[chosen], fused=False))
        assert sfr("score", path, folder, "--limits", rules).code == code, code


def test_points_without_pixels_are_repeated_at_one_place(tmp_path: Path, sfr: Sfr) -> None:
    """A tenth of the points is 0.5 m too far away; the others, each twenty times, hide them from the 95 % quantile."""
    folder, path = write_folder(tmp_path / "nav", 0, 1), tmp_path / "points.npz"
    rules = limits(tmp_path, {"map": {"nearest_distance_p95_m": 0.1}})
    xyz = true_cloud().xyz.astype(np.float64)
    is_wrong = np.arange(len(xyz)) % 10 == 0
    wrong = xyz + 0.5 * is_wrong[:, None] * [1.0, 0.0, 0.0]
    good = wrong[~is_wrong]
    twenty = np.tile(good, (20, 1))
    moved = twenty + np.random.default_rng(1).normal(0.0, 1e-4, twenty.shape)
    sparse = wrong[::3]
    at_one = good[0] + np.random.default_rng(2).normal(0.0, 1e-5, (2 * len(sparse) - 9, 3))
    cases = (
        (wrong, 1),
        (good, 0),
        (sparse, 1),
        (np.vstack((wrong, twenty)), 3),
        (np.vstack((wrong, moved)), 3),
        (np.vstack((sparse, at_one)), 3),
    )
    for points, code in cases:
        save_points(path, points)
        done = sfr("score", path, folder, "--limits", rules)
        assert done.code == code, (len(points), code)
        assert "deviation: The pixels of the map points are unknown." in done.out


def test_a_range_without_a_true_pixel_requires_no_point_and_is_incomplete(tmp_path: Path, sfr: Sfr) -> None:
    """Three exact points are not a map, even where no true pixel is in the scored range."""
    folder, cloud = write_folder(tmp_path / "data", 0, 1), tmp_path / "c.ply"
    truth = nav_pair(0).truth
    assert truth is not None
    v, u = (part.ravel()[:3].astype(np.uint16) for part in np.indices(truth.shape[:2]))
    points, same = truth[v, u] + 0.001, np.full(3, 0.05, np.float32)
    save_cloud(cloud, PointCloud(points, same, same, u, v, np.zeros(3, np.uint8), fused=False))
    rules = limits(tmp_path, {"map": {"point_error_p95_m": 0.01}})
    for options, said in (
        ((), "has no map point at"),
        (("--range", "5000", "6000"), "has a pixel with ground truth in the scored"),
    ):
        done = sfr("score", cloud, folder, "--limits", rules, *options)
        assert (done.code, said in done.out) == (3, True), done.out + done.err
