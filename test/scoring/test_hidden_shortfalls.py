"""Runs whose shortfalls an earlier version did not count, judged by the commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.interpolate import CubicSpline

from helpers.cli_result import Sfr
from helpers.made_scene import nav_pair, write_folder
from helpers.made_suites import made_suite
from helpers.made_suites import straight as made_drive
from helpers.straight_drive import COUNT, PERIOD_NS, POSITION, limits
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import save_cloud, save_points
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_file import save_trajectory
from sfr_loc_map.metrics.judging.several_scores import difference_of
from sfr_loc_map.metrics.score import Score

LOOSE = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 1.0}]}


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


def test_images_that_are_not_expected_any_more_change_the_provenance(tmp_path: Path, sfr: Sfr) -> None:
    """The list of pairs or the rig was changed: the truth is the same, the images are not."""
    folder, poses, page = write_folder(tmp_path / "data", 40, 1), tmp_path / "e.csv", tmp_path / "t.html"
    truth = open_source(folder).truth
    assert truth is not None
    save_trajectory(poses, Trajectory(truth.stamps_ns, 0.999 * truth.positions, truth.quats_xyzw))
    table, rig = folder / "loc" / "pairs.csv", folder / "loc" / "rig.json"
    whole, camera, found = table.read_text(), rig.read_text(), []
    fewer, wider = "".join(whole.splitlines(keepends=True)[:-5]), json.loads(camera)
    wider["baseline_m"] *= 2.0
    for number, texts in enumerate(((whole, camera), (fewer, camera), (whole, json.dumps(wider)))):
        table.write_text(texts[0])
        rig.write_text(texts[1])
        sfr("score", poses, folder, "--json", tmp_path / f"{number}.json")
        found.append(Score.load(tmp_path / f"{number}.json"))
    inputs = [score.provenance.inputs for score in found if score.provenance is not None]
    assert [len({item[role].sha256 for item in inputs}) for role in ("truth", "images")] == [1, 3]
    assert difference_of(found) == "the scores are of several sets of images, which a suite judges together"
    sfr("report", tmp_path / "0.json", "--test-report", page)
    assert inputs[0]["images"].sha256 in page.read_text()


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


@pytest.mark.slow
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


@pytest.mark.slow
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


def wandering(sigma_m: float, seed: int = 1, count: int = COUNT) -> Trajectory:
    """A bend of 0.1 m a step with an error that accumulates on each step and on the heading."""
    rng, heading = np.random.default_rng(seed), np.linspace(0.0, 2.0, count)
    steps = 0.1 * np.column_stack((np.cos(heading), np.sin(heading), 0.2 * np.sin(8.0 * heading)))
    positions = np.cumsum(steps + rng.normal(0.0, sigma_m, (count, 3)), axis=0)
    turned = 0.5 * (heading + np.cumsum(rng.normal(0.0, sigma_m, count)))
    quats = np.column_stack((np.zeros((count, 2)), np.sin(turned), np.cos(turned)))
    return Trajectory(np.arange(count) * PERIOD_NS, positions, quats)


def test_every_stamp_that_occurs_twice_and_every_pose_that_repeats_another_counts(tmp_path: Path, sfr: Sfr) -> None:
    """One pose of 300, which earlier versions did not mention below a tenth; a slow start repeats nothing."""
    paths, score = (tmp_path / "e.csv", tmp_path / "t.csv"), tmp_path / "s.json"
    truth, good = wandering(0.0), wandering(1e-3)
    save_trajectory(paths[1], truth)
    again = np.insert(np.arange(COUNT), 50, 49)
    doubled = Trajectory(good.stamps_ns[again], good.positions[again], good.quats_xyzw[again])
    copied = np.arange(COUNT)
    copied[101:104] = 100
    repeated = Trajectory(good.stamps_ns, good.positions[copied], good.quats_xyzw[copied])
    for estimate, figure, count, code in (
        (good, "doubled", 0, 0),
        (doubled, "doubled", 1, 3),
        (repeated, "poses_repeated", 3, 3),
    ):
        save_trajectory(paths[0], estimate)
        for more, expected in (({}, code), ({"completeness": {f"{figure}_max_share": 0.02}}, 0)):
            rules = limits(tmp_path, {**LOOSE, **more})
            assert sfr("score", *paths, "--limits", rules, "--json", score, "--overwrite").code == expected, figure
            (row,) = (
                row
                for row in json.loads(score.read_text())["figures"]
                if (row["figure"], row.get("part")) == (figure, "count")
            )
            assert row["value"] == count
    calls = tmp_path / "e.stats.csv"
    states = ["lost" if row in (101, 102, 103) else "tracking" for row in range(COUNT)]
    rows = [f"{stamp},0.1,{state}" for stamp, state in zip(good.stamps_ns, states, strict=True)]
    calls.write_text("\n".join(["stamp_ns,processing_time_s,state", *rows]) + "\n")
    assert sfr("score", *paths, "--limits", limits(tmp_path, LOOSE)).code == 0, "reported as lost"


def test_a_rover_that_stands_and_a_slow_start_repeat_no_pose(tmp_path: Path, sfr: Sfr) -> None:
    """The truth has noise of 1 mm; the estimate knows that the rover stands."""
    truth, good = wandering(0.0), wandering(1e-3)
    stands = np.minimum(np.arange(COUNT), 250)
    noise = np.random.default_rng(2).normal(0.0, 1e-3, (COUNT, 3))
    save_trajectory(tmp_path / "t.csv", Trajectory(truth.stamps_ns, truth.positions[stands] + noise, truth.quats_xyzw))
    save_trajectory(tmp_path / "e.csv", Trajectory(good.stamps_ns, good.positions[stands], good.quats_xyzw[stands]))
    rules = limits(tmp_path, {**LOOSE, "minimum_independent": 1})
    assert sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", rules).code == 0


def test_a_copy_of_the_truth_is_found_if_it_is_changed_rounded_resampled_or_moved(tmp_path: Path, sfr: Sfr) -> None:
    paths, truth = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0)
    save_trajectory(paths[1], truth)
    fine_ns = truth.stamps_ns[:-1] + 3 * PERIOD_NS // 7
    at_s, time_s = fine_ns * 1e-9, truth.stamps_ns * 1e-9
    linear = np.stack([np.interp(at_s, time_s, axis) for axis in truth.positions.T], axis=1)
    moved = truth.positions @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).T + 3.0
    half = np.sqrt(0.5)
    x, y, z, w = truth.quats_xyzw.T
    turned = np.column_stack((half * (x - y), half * (x + y), half * (z + w), half * (w - z)))
    part = wandering(1e-3).positions
    part[100:200] = part[100] - truth.positions[100] + truth.positions[100:200]
    copies = {
        "a bit": (truth.stamps_ns, np.nextafter(truth.positions, 9.0), truth.quats_xyzw),
        "own attitudes": (truth.stamps_ns, truth.positions, wandering(1e-3).quats_xyzw),
        "linear": (fine_ns, linear, truth.quats_xyzw[:-1]),
        "spline": (fine_ns, CubicSpline(time_s, truth.positions)(at_s), truth.quats_xyzw[:-1]),
        "moved": (truth.stamps_ns, moved, turned),
        "a third of the drive": (truth.stamps_ns, part, truth.quats_xyzw),
    }
    for digits in (3, 4, 5, 6):
        copies[f"{digits} decimals"] = (truth.stamps_ns, np.round(truth.positions, digits), truth.quats_xyzw)
    for name, columns in copies.items():
        save_trajectory(paths[0], Trajectory(*columns))
        for option in ((), ("--partial",)):
            done = sfr("score", *paths, "--limits", limits(tmp_path, LOOSE), *option)
            assert (done.code, "of the steps are those of the ground truth" in done.err) == (3, True), (name, done.err)
    labelled = limits(tmp_path, {**LOOSE, "completeness": {"poses_of_truth_max_share": 1.0}})
    assert sfr("score", *paths, "--limits", labelled).code == 0, "a simulated estimate without an error says so"


@pytest.mark.parametrize("kept", [10, 2])
def test_true_poses_at_starts_and_ends_alone_are_a_copy(tmp_path: Path, sfr: Sfr, kept: int) -> None:
    """Sub-trajectories of 5 m start and end at every tenth frame; no two successive poses are of the truth."""
    paths, truth, own = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0), wandering(1e-3)
    is_true = np.arange(COUNT) % kept == 0
    positions = np.where(is_true[:, None], truth.positions, own.positions)
    quats = np.where(is_true[:, None], truth.quats_xyzw, own.quats_xyzw)
    save_trajectory(paths[0], Trajectory(truth.stamps_ns, positions, quats))
    save_trajectory(paths[1], truth)
    condition = {"condition": "frames=50", "position_mean_plus_3sigma_m": 1.0}
    for option in ((), ("--partial",)):
        done = sfr("score", *paths, "--limits", limits(tmp_path, {"trajectory": [condition]}), *option)
        assert (done.code, "of the judged motions from a start to an end" in done.err) == (3, True), done.err


def test_a_rover_that_returns_to_its_start_has_no_true_motion(tmp_path: Path, sfr: Sfr) -> None:
    """It stands for a third of the drive, where estimate and truth agree exactly."""
    paths, truth, own = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(0.0), wandering(1e-3)
    stands = np.minimum(np.arange(COUNT), 200)
    for path, drive in zip(paths, (own, truth), strict=True):
        save_trajectory(path, Trajectory(drive.stamps_ns, drive.positions[stands], drive.quats_xyzw[stands]))
    condition = {"condition": "frames=20", "position_mean_plus_3sigma_m": 1.0}
    assert sfr("score", *paths, "--limits", limits(tmp_path, {"trajectory": [condition]})).code == 0


@pytest.mark.parametrize("digits", [3, 4, 6, 12])
@pytest.mark.parametrize("sigma_m", [1e-4, 1e-3])
def test_an_excellent_estimate_is_no_copy_of_the_truth(tmp_path: Path, sfr: Sfr, sigma_m: float, digits: int) -> None:
    """Noise of 0.1 mm a step of 100 mm: at the end of 30 m the error is a few mm."""
    paths, good = (tmp_path / "e.csv", tmp_path / "t.csv"), wandering(sigma_m)
    save_trajectory(paths[1], wandering(0.0))
    save_trajectory(paths[0], Trajectory(good.stamps_ns, np.round(good.positions, digits), good.quats_xyzw))
    done = sfr("score", *paths, "--limits", limits(tmp_path, LOOSE))
    assert done.code == 0, done.err


def test_scores_of_several_runs_have_no_pass_in_common(tmp_path: Path, sfr: Sfr) -> None:
    """Other items, versions, configurations and sources: each score passes, and the test report has no verdict."""
    paths = tmp_path / "e.csv", tmp_path / "t.csv"
    save_trajectory(paths[1], wandering(0.0))
    save_trajectory(paths[0], wandering(1e-3))
    header = "stamp_ns,processing_time_s,state,method,method_version,method_kind"
    stamps = wandering(0.0).stamps_ns

    def scored(name: str, *options: str, version: str = "1", truth: Path = paths[1]) -> Path:
        rows = [f"{stamp},0.1,tracking,mine,{version},python" for stamp in stamps]
        (tmp_path / "e.stats.csv").write_text("\n".join([header, *rows]) + "\n")
        found = tmp_path / f"{name}.json"
        assert sfr("score", paths[0], truth, "--limits", rules, "--json", found, *options).code == 0
        return found

    rules, moved = limits(tmp_path, LOOSE), tmp_path / "moved.csv"
    other = wandering(0.0)
    save_trajectory(moved, Trajectory(stamps, other.positions + 1.0, other.quats_xyzw))
    first, same = scored("first"), scored("same")
    changed = json.loads(first.read_text())
    changed["provenance"]["version"] = "0.0.1"
    (tmp_path / "version.json").write_text(json.dumps(changed))
    (tmp_path / "unknown.json").write_text(json.dumps({**changed, "provenance": None}))
    mixed = {
        "2 items under test": scored("item", version="2"),
        "several versions": tmp_path / "version.json",
        "not every score says what it was made of": tmp_path / "unknown.json",
        "several configurations (trajectory.spacing)": scored("spacing", "--spacing", "5"),
        "several ground truths": scored("source", truth=moved),
    }
    page = tmp_path / "report.html"
    assert sfr("report", first, same, "--test-report", page).code == 0
    for text, path in mixed.items():
        done = sfr("report", first, path, "--test-report", page, "--overwrite")
        assert (done.code, text in done.err) == (3, True), (text, done.err)
        assert "<strong>NO COMMON VERDICT" in page.read_text()


@pytest.mark.slow
def test_the_order_of_the_drives_in_the_file_decides_nothing(tmp_path: Path, sfr: Sfr) -> None:
    """One of three drives is bad. The first drive decides; drives are taken in the order of their hashes."""
    folder, found = tmp_path / "suite", []
    made_suite(folder, 3, 1e-3)
    save_trajectory(folder / "drive0.csv", made_drive(60, 0.1, 9))
    content = yaml.safe_load((folder / "suite.yaml").read_text())
    bound = {"limit": 0.02, "prob": 0.5, "confidence": 0.5, "power": 0.5, "good": 0.0, "interpretation": "ensemble"}
    content["limits"] = {"trajectory": [{"condition": "distance=1", "position_bound_m": bound}]}
    for number, step in enumerate((1, -1)):
        suite = folder / f"suite{number}.yaml"
        suite.write_text(yaml.safe_dump({**content, "sources": content["sources"][::step]}))
        sfr("suite", "run", suite, "--out", tmp_path / f"out{number}", "--workers", "1")
        found.append(json.loads((tmp_path / f"out{number}" / "suite.json").read_text()))
    first, second = ([item for group in suite["groups"] for item in group["verdicts"]] for suite in found)
    assert first == second
    assert found[0]["groups"] == found[1]["groups"]


FAILING = """
import numpy as np


class Failing:
    version = "1"

    def __init__(self, rig, config):
        self.count = 0

    def process(self, pair):
        self.count += 1
        if self.count == 5:
            raise RuntimeError("out of features")
        pose = np.eye(4)
        pose[0, 3] = 0.02 * self.count
        return pose
"""


def test_a_failed_call_is_found_although_nobody_names_the_calls(tmp_path: Path, sfr: Sfr) -> None:
    """Without `--stats` the calls are written beside the result, and the score reads them."""
    source, method, estimate = write_folder(tmp_path / "data", 12, 0), tmp_path / "mine.py", tmp_path / "e.csv"
    method.write_text(FAILING)
    done = sfr("localise", source, "-o", estimate, "--start", "truth", "--method", f"{method}:Failing")
    assert done.code == 1
    assert (tmp_path / "e.stats.csv").is_file()
    loose = {"minimum_independent": 1, "trajectory": [{"condition": "frames=2", "position_mean_plus_3sigma_m": 9.0}]}
    rules, score = limits(tmp_path, loose), tmp_path / "s.json"
    assert sfr("score", estimate, source, "--limits", rules, "--json", score).code == 1
    assert [item["kind"] for item in json.loads(score.read_text())["findings"]] == ["raised"]


@pytest.mark.parametrize(
    "content",
    [
        {"timing": {"localisation_max_s": 1.0}},
        {"memory": {"localisation_peak_bytes": 1e9}},
        {"trajectory": [{"condition": "distance=5", "lost_max_share": 0.0}]},
    ],
)
def test_without_calls_a_limit_on_them_is_incomplete(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr, content: dict[str, object]
) -> None:
    score = tmp_path / "s.json"
    done = sfr("score", *files, "--limits", limits(tmp_path, content), "--json", score)
    assert (done.code, json.loads(score.read_text())["verdict"]) == (3, "incomplete")
    assert "give the calls of the run (--stats)" in done.err
