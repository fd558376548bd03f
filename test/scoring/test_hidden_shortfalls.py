"""Runs whose shortfalls an earlier version did not count, judged by the commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from helpers.cli_result import Sfr
from helpers.made_scene import nav_pair, write_folder
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import save_cloud, save_points
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_file import save_trajectory

PERIOD_NS = 100_000_000
COUNT = 300
POSITION = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.05}]}


def straight(scale: float = 1.0) -> Trajectory:
    positions = np.column_stack((0.1 * scale * np.arange(COUNT), np.zeros((COUNT, 2))))
    return Trajectory(np.arange(COUNT) * PERIOD_NS, positions, np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)))


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """An estimate that is 0.1 % short, and its truth."""
    paths = tmp_path / "estimate.csv", tmp_path / "truth.csv"
    for path, scale in zip(paths, (0.999, 1.0), strict=True):
        save_trajectory(path, straight(scale))
    return paths


def limits(folder: Path, content: object) -> Path:
    path = folder / "limits.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def cloud_of(number: int) -> PointCloud:
    """A point at the true place of each pixel of a mapping pair."""
    truth = nav_pair(number).truth
    assert truth is not None
    v, u = (part.ravel().astype(np.uint16) for part in np.indices(truth.shape[:2]))
    same = np.full(len(u), 0.05, np.float32)
    return PointCloud(truth.reshape(-1, 3), same, same, u, v, np.full(len(u), number, np.uint8), fused=False)


def test_pairs_whose_images_were_deleted_are_expected_all_the_same(tmp_path: Path, sfr: Sfr) -> None:
    """Their stamps are listed in pairs.csv: an estimate and a map of the other pairs are incomplete."""
    folder, poses, cloud = write_folder(tmp_path / "data", 40, 2), tmp_path / "e.csv", tmp_path / "c.ply"
    truth = open_source(folder).truth
    assert truth is not None
    is_kept = np.arange(len(truth)) % 4 > 0
    kept = (truth.stamps_ns[is_kept], 0.999 * truth.positions[is_kept], truth.quats_xyzw[is_kept])
    save_trajectory(poses, Trajectory(*kept))
    content = {"minimum_independent": 1, "map": {"point_error_p95_m": 1.0}}
    content |= {"trajectory": [{"condition": "frames=4", "position_mean_plus_3sigma_m": 1.0}]}
    rules = limits(tmp_path, content)
    for row in np.flatnonzero(~is_kept):
        (folder / "loc" / "left" / f"{row:06d}.png").unlink()
    score = tmp_path / "s.json"
    assert sfr("score", poses, folder, "--limits", rules, "--json", score).code == 3
    missing = [row for row in json.loads(score.read_text())["figures"] if row["figure"] == "missing"]
    assert [(row["n"], row["value"]) for row in missing] == [(40, 0.25), (40, 10.0)]
    save_cloud(cloud, cloud_of(0))
    (folder / "nav" / "right" / "000001.png").unlink()
    done = sfr("score", cloud, folder, "--limits", rules)
    assert done.code == 3
    assert "50 % of the mapping pairs have no point in the cloud" in done.out


def test_times_on_a_target_without_stamps_are_of_no_known_pair(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr
) -> None:
    rules = limits(tmp_path, {**POSITION, "target": {"localisation_max_s": 1.0}})
    times = tmp_path / "times.csv"
    for stamps, code in ((range(COUNT), 0), (None, 3), (range(1, COUNT + 1), 3)):
        rows = ["stamp_ns,processing_time_s,state", *(f"{row * PERIOD_NS},0.1,tracking" for row in stamps or ())]
        if stamps is None:
            rows = ["processing_time_s,state", *["0.1,tracking"] * COUNT]
        times.write_text("\n".join(rows) + "\n")
        options = ["--target", "GR740", "--target-timing", times, "--target-run", "of the kit", "--limits", rules]
        assert sfr("score", *files, *options).code == code, code


def test_points_without_pixels_are_repeated_at_one_place(tmp_path: Path, sfr: Sfr) -> None:
    """A tenth of the points is 0.5 m too far away; the others, each twenty times, hide them from the 95 % quantile."""
    folder, path = write_folder(tmp_path / "nav", 0, 1), tmp_path / "points.npz"
    rules = limits(tmp_path, {"map": {"nearest_distance_p95_m": 0.1}})
    xyz = np.asarray(cloud_of(0).xyz, np.float64)
    is_wrong = np.arange(len(xyz)) % 10 == 0
    wrong = xyz + 0.5 * is_wrong[:, None] * [1.0, 0.0, 0.0]
    good = wrong[~is_wrong]
    twenty = np.tile(good, (20, 1))
    moved = twenty + np.random.default_rng(1).normal(0.0, 1e-4, twenty.shape)
    for points, code in ((wrong, 1), (good, 0), (np.vstack((wrong, twenty)), 3), (np.vstack((wrong, moved)), 3)):
        save_points(path, points)
        assert sfr("score", path, folder, "--limits", rules).code == code, (len(points), code)


def test_a_suite_of_maps_passes_a_limit_on_the_mapping_call(tmp_path: Path, sfr: Sfr) -> None:
    """The pairs of its sources are expected, so that the calls are known to be complete; a deleted pair is missing."""
    rules = {"map": {"point_error_p95_m": 10.0, "coverage_min": 0.1}, "timing": {"mapping_call_s": 100.0}}
    by = {"tasks": ["map"], "configurations": {"sgbm": {"mapping": {"method": "sgbm"}}}, "limits": rules}
    for name, code in (("whole", 0), ("part", 3)):
        folder, suite = write_folder(tmp_path / name, 0, 2), tmp_path / f"{name}.yaml"
        if name == "part":
            (folder / "left" / "000001.png").unlink()
        suite.write_text(yaml.safe_dump({"sources": [name], **by}))
        done = sfr("suite", "run", suite, "--out", tmp_path / f"out_{name}", "--workers", "1")
        assert done.code == code, done.out + done.err


def test_a_suite_refuses_a_result_that_names_no_job(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    suite, out = tmp_path / "suite.yaml", tmp_path / "out"
    pairs = [{"estimate": "estimate.csv", "truth": "truth.csv"}]
    suite.write_text(yaml.safe_dump({"sources": pairs, "limits": POSITION}))
    assert sfr("suite", "run", suite, "--out", out, "--workers", "1").code == 0
    (result,) = (out / "results").glob("*.json")
    score = json.loads(result.read_text())
    del score["provenance"]["configuration"]["suite.key"]
    result.write_text(json.dumps(score))
    done = sfr("suite", "report", out, "--overwrite")
    assert done.code == 2
    assert "does not name its job" in done.err
