"""What a verdict says before it can be signed: each of these passed, or misled, in silence once."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import statistics
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from helpers import score_rows
from helpers.cli_result import Result, Sfr
from helpers.made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair
from helpers.made_suites import made_suite
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import load_cloud, save_cloud
from sfr_loc_map.io.layouts.folder import FolderWriter
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file, save_trajectory

COUNT, PERIOD_NS, STEP_M = 401, 100_000_000, 0.15
SKY_ROWS = 30  #: Uppermost rows of the made mapping pairs that see no surface.
FEW = "minimum_independent: 2\n"
SUM = "trajectory:\n- condition: distance=5\n  position_mean_plus_3sigma_m: "


def rows_of(trajectory: Trajectory, rows: Any) -> Trajectory:
    return Trajectory(trajectory.stamps_ns[rows], trajectory.positions[rows], trajectory.quats_xyzw[rows])


class Judge:
    """A drive of 60 m, an estimate that errs by millimetres, and the command that judges files of them."""

    def __init__(self, sfr: Sfr, folder: Path) -> None:
        self.sfr, self.folder = sfr, folder
        place = np.arange(COUNT)  # a bend over hills: height, roll and pitch of a plane would not be judged
        heading = Rotation.from_euler("ZY", np.column_stack((0.4 * np.sin(0.02 * place), 0.05 * np.sin(0.05 * place))))
        self.steps = heading.apply(np.tile([STEP_M, 0.0, 0.0], (COUNT, 1)))
        self.heading = heading
        stamps = 100 * 10**9 + PERIOD_NS * np.arange(COUNT, dtype=np.int64)
        self.truth = Trajectory(stamps, np.cumsum(self.steps, axis=0), heading.as_quat())
        noise = np.cumsum(np.random.default_rng(1).normal(0.0, 0.002, (COUNT, 3)), axis=0)
        self.estimate = replace(self.truth, positions=self.truth.positions + noise)

    def limits(self, text: str) -> Path:
        path = self.folder / "limits.yaml"
        path.write_text(text)
        return path

    def poses(self, name: str, trajectory: Trajectory) -> Path:
        save_trajectory(self.folder / name, trajectory)
        return self.folder / name

    def calls(self, stamps: Any, name: str = "calls.csv", peak: Any = "", state: str = "tracking") -> Path:
        rows = [f"{stamp},0.1,{state},{peak}" for stamp in stamps]
        (self.folder / name).write_text("\n".join(["stamp_ns,processing_time_s,state,peak_rss_bytes", *rows, ""]))
        return self.folder / name

    def __call__(
        self, *options: Any, limits: str | None = None, estimate: Trajectory | None = None, truth: Any = None
    ) -> tuple[Result, dict[str, Any]]:
        """Score an estimate; return what the command gave, and its JSON."""
        made = self.poses("estimate.csv", self.estimate if estimate is None else estimate)
        true = truth if isinstance(truth, Path) else self.poses("truth.csv", self.truth if truth is None else truth)
        judged = [] if limits is None else ["--limits", self.limits(limits)]
        (report := self.folder / "score.json").unlink(missing_ok=True)
        result = self.sfr("score", made, true, *judged, "--json", report, *options)
        return result, json.loads(report.read_text()) if report.is_file() else {}


@pytest.fixture
def judge(sfr: Sfr, tmp_path: Path) -> Judge:
    return Judge(sfr, tmp_path)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 12 pairs, and two mapping pairs whose upper rows see the sky."""
    path = tmp_path_factory.mktemp("signed") / "source"
    with FolderWriter(path, loc=True, nav=True) as writer:
        writer.write_loc_rig(LOC_RIG)
        writer.write_nav_rig(NAV_RIG)
        for index in range(12):
            writer.write_truth(loc_pair(index).stamp_ns, np.array([0.02 * index, 0.0, 0.0]), np.array([0, 0, 0, 1.0]))
            writer.write_loc_pair(loc_pair(index))
        for pair in (nav_pair(0), nav_pair(1)):
            assert pair.truth is not None
            pair.truth[:SKY_ROWS] = np.nan
            writer.write_nav_pair(pair)
    return path


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    """Each pixel of two mapping pairs on its true point, those of the sky at 5 m."""
    clouds = []
    for number in range(2):
        truth = nav_pair(number).truth
        assert truth is not None
        xyz = truth.reshape(-1, 3).astype(np.float32)
        v, u = (part.ravel().astype(np.uint16) for part in np.indices(truth.shape[:2]))
        same = np.full(len(xyz), 0.05, np.float32)
        clouds.append(PointCloud(xyz, same, same, u, v, np.full(len(xyz), number, np.uint8), fused=False))
    save_cloud(tmp_path / "cloud.ply", PointCloud.concatenate(clouds))
    return tmp_path / "cloud.ply"


@pytest.mark.clause("4.2.2")
@pytest.mark.parametrize("peak", ["0", ""])
@pytest.mark.parametrize("part", ["memory", "target"])
def test_memory_of_zero_is_not_known(judge: Judge, peak: str, part: str) -> None:
    calls = judge.calls(judge.estimate.stamps_ns, peak=peak)
    options = ["--stats", calls] if part == "memory" else ["--target", "board", "--target-timing", calls]
    result, score = judge(*options, limits=f"{part}:\n  localisation_peak_bytes: 1000000\n")
    assert result.code == 3
    assert [item["verdict"] for item in score["verdicts"]] == ["not enough data"]
    result, score = judge(
        *options[:-1],
        judge.calls(judge.estimate.stamps_ns, peak="900000"),
        limits=f"{part}:\n  localisation_peak_bytes: 1000000\n",
    )
    assert (result.code, score["verdicts"][0]["value"]) == (0, 900_000)


@pytest.mark.clause("4.1.1")
def test_half_a_drive_is_incomplete_unless_asked_for(judge: Judge) -> None:
    half = rows_of(judge.estimate, slice(201))
    result, score = judge(limits=FEW + SUM + "1\n", estimate=half)
    assert result.code == 3
    assert [item["verdict"] for item in score["verdicts"]] == ["incomplete", "incomplete"]
    assert "not judged: incomplete: the estimate covers 50.12 % of the true poses" in result.err
    first = next(line for line in result.out.splitlines() if "verdict:" in line or "incomplete:" in line)
    assert first.startswith("incomplete:")
    assert score_rows.number(score, "missing", part="count") == 200

    result, score = judge("--partial", limits=FEW + SUM + "1\n", estimate=half)
    assert (result.code, [item["verdict"] for item in score["verdicts"]]) == (0, ["pass"])
    assert "a part of the drive is judged" in result.err
    assert judge(estimate=half)[0].code == 3  # without limits too
    assert judge(limits=FEW + SUM + "0.001\n", estimate=half)[0].code == 1  # a missed limit counts before


def test_a_share_may_be_missing_where_a_limit_says_so(judge: Judge) -> None:
    half = rows_of(judge.estimate, slice(201))
    for share, code in ((0.6, 0), (0.4, 1)):
        for text in (
            f"completeness:\n  missing_max_share: {share}\n",
            f"completeness:\n  - missing_max_share: {share}\n    id: A\n  - doubled_max_share: 0\n",
            f"{FEW}{SUM}1\n  missing_max_share: {share}\n",
            f"{FEW}{SUM}1\n  missing_max_share: {{limit: {share}, id: A, certain: true}}\n",
        ):
            result, score = judge(limits=text, estimate=half)
            assert result.code == code, text
            found = next(item for item in score["verdicts"] if item["name"] == "missing_max_share")
            assert found["value"] == pytest.approx(0.5, abs=0.003)


def test_lost_and_degraded_frames_have_limits_of_their_own(judge: Judge) -> None:
    calls = judge.calls(judge.estimate.stamps_ns[:40], state="lost")
    more = judge.calls(judge.estimate.stamps_ns[40:], "more.csv")
    calls.write_text(calls.read_text() + "".join(more.read_text().splitlines(keepends=True)[1:]))
    for limit, code in ((0.2, 0), (0.05, 1)):
        result, score = judge("--stats", calls, limits=f"completeness:\n  lost_max_share: {limit}\n")
        assert result.code == code
        assert score["verdicts"][0]["value"] == pytest.approx(40 / COUNT)


@pytest.mark.clause("4.3.4")
def test_points_in_the_sky_are_a_limited_share(sfr: Sfr, judge: Judge, source: Path, cloud: Path) -> None:
    share = SKY_ROWS / NAV_RIG.height
    for part in ("map", "completeness"):
        for limit, code in ((share + 0.01, 0), (share - 0.01, 1)):
            limits = judge.limits(f"{part}:\n  points_without_truth_max_share: {limit}\n")
            result = sfr("score", cloud, source, "--limits", limits, "--json", "-")
            assert result.code == code, result.err
            assert json.loads(result.out)["verdicts"][0]["value"] == pytest.approx(share)


def test_what_belongs_to_nothing_has_limits(sfr: Sfr, judge: Judge, source: Path, cloud: Path) -> None:
    """Estimates without truth, doubled stamps, and mapping pairs that the cloud leaves out."""
    part, twice = rows_of(judge.truth, slice(300)), rows_of(judge.estimate, np.r_[0:COUNT, 0:20])
    for name, options, share in (
        ("unmatched", {"truth": part}, 101 / COUNT),
        ("doubled", {"estimate": twice}, 20 / (COUNT + 20)),
    ):
        for limit, code in ((share + 0.01, 0), (share - 0.01, 1)):
            result, score = judge(limits=f"{SUM}1\n  {name}_max_share: {limit}\n", **options)
            assert result.code == code, result.err
            assert score["verdicts"][1]["value"] == pytest.approx(share)
    whole = load_cloud(cloud).cloud
    assert whole is not None
    first = whole.pair == 0
    columns = (getattr(whole, name)[first] for name in ("xyz", "sigma", "intensity", "u", "v", "pair"))
    save_cloud(cloud, PointCloud(*columns, fused=False))
    limits = judge.limits("map:\n  pairs_without_cloud_max_share: 0.4\n")
    result = sfr("score", cloud, source, "--limits", limits, "--json", "-")
    assert (result.code, json.loads(result.out)["verdicts"][-1]["value"]) == (1, 0.5)


def test_two_runs_in_one_file_are_refused(judge: Judge) -> None:
    moved = judge.estimate.positions + np.array([100.0, 0.0, 0.0])
    twice = (np.concatenate([part, part]) for part in (judge.estimate.stamps_ns, judge.estimate.quats_xyzw))
    stamps, quats = twice
    result, _ = judge(estimate=Trajectory(stamps, np.concatenate([judge.estimate.positions, moved]), quats))
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert "two runs" in result.err


@pytest.mark.clause("4.1.2", "4.2.3.1", "4.2.3.2", "4.2.3.3")
def test_the_readings_differ_under_drift_and_the_result_says_which_verdict_they_decide(judge: Judge) -> None:
    """0.1 deg/m over 60 m: `pose` is small, the displacement in DS turns with the heading, `position` counts all."""
    drift = Rotation.from_euler("z", (0.1 * STEP_M * np.arange(COUNT))[:, None], degrees=True)
    turned = (drift * judge.heading).as_quat()
    drifting = replace(judge.truth, positions=np.cumsum(drift.apply(judge.steps), axis=0), quats_xyzw=turned)
    result, score = judge(limits=SUM + "0.3\n  attitude_mean_plus_3sigma_deg: 1\n", estimate=drifting)
    readings = ("pose", "displacement", "position")
    position = {name: score_rows.number(score, "position", "mean_plus_3sigma", part=name) for name in readings}
    attitude = {name: score_rows.number(score, "attitude", "mean_plus_3sigma", part=name) for name in readings}
    assert position["pose"] < 0.05
    assert position["displacement"] == pytest.approx(position["position"], abs=1e-9)
    assert position["displacement"] > 0.7
    assert attitude["pose"] == pytest.approx(attitude["displacement"], abs=1e-6)
    assert attitude["position"] > 8.0
    assert score["verdicts"][0]["by_reading"] == {"pose": "pass", "displacement": "fail", "position": "fail"}
    assert "decides 2 of 2 verdicts" in result.err
    for reading, code in (("pose", 0), ("displacement", 1), ("position", 1)):
        result, score = judge("--rebase", reading, limits=SUM + "0.3\n", estimate=drifting)
        assert (result.code, score["association"]["rebase"]) == (code, reading)
        assert score["verdicts"][0]["value"] == position[reading]
    assert "decides" not in judge(limits=SUM + "5\n", estimate=drifting)[0].err


@pytest.mark.clause("1.3", "4.3.1", "4.3.2")
def test_three_pairs_to_one_cloud_are_one_call_with_time_and_memory(sfr: Sfr, judge: Judge, source: Path) -> None:
    made, stats = judge.folder / "made.ply", judge.folder / "made.csv"
    assert sfr("map", source, "-o", made, "--stats", stats).code == 0
    sky = "map:\n  points_without_truth_max_share: 0.5\n"
    limits = judge.limits(f"{sky}timing:\n  mapping_call_s: 600\nmemory:\n  mapping_call_peak_bytes: 100000000000\n")
    result = sfr("score", made, source, "--stats", stats, "--limits", limits, "--json", "-")
    assert result.code == 0, result.err
    score = json.loads(result.out)
    whole = score_rows.row(score, "mapping_call")
    assert whole["n"] == 1
    parts = score_rows.number(score, "mapping", "mean") * 2 + score_rows.number(score, "fusion", "mean")
    assert whole["max"] >= 0.99 * parts
    assert [item["verdict"] for item in score["verdicts"]] == ["pass", "pass", "pass"]


@pytest.mark.clause("4.2.1")
def test_times_of_a_target_belong_to_the_estimate_by_stamp(judge: Judge) -> None:
    few = judge.calls(judge.estimate.stamps_ns[:50])
    result, score = judge("--target", "board", "--target-timing", few)
    assert (result.code, score["target"]["matched_share"]) == (0, 50 / COUNT)
    assert "the times of board are of 12.5 % of the estimates" in result.err
    other = ("--target", "board", "--target-timing", judge.calls(range(5, 55)))
    result, _ = judge(*other)
    assert result.code == 2
    assert "another run" in result.err.splitlines()[-1]
    result, score = judge(*other, "--target-run", "Tuesday")
    assert (result.code, score["target"]["other_run"]) == (0, "Tuesday")
    assert "another run: Tuesday" in result.err
    assert judge("--target-run", "Tuesday")[0].code == 2  # of no target


@pytest.mark.parametrize("text", ["[1]", "{}", "no JSON", '{"schema": "sfr-target/1", "board": 5}'])
def test_what_a_target_says_of_itself_is_refused_in_one_line(judge: Judge, text: str) -> None:
    judge.calls(judge.estimate.stamps_ns, "stats.csv")
    (judge.folder / "target.json").write_text(text)
    result = judge.sfr("score", judge.folder, judge.poses("truth.csv", judge.truth))
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert "target" in result.err


@pytest.mark.clause("4.1.1")
def test_frames_that_are_true_poses_not_images_are_said(judge: Judge) -> None:
    sparse = rows_of(judge.truth, slice(None, None, 5))
    result, score = judge(truth=sparse)
    assert (result.code, score["association"]["matched"]) == (0, 81)
    assert "the truth has 81 poses for 401 estimates" in result.err
    result, score = judge("--frames", "images", truth=sparse)
    assert (result.code, score["association"]["matched"]) == (0, COUNT)
    assert score["association"]["mode"] == "interpolate"
    assert "81 poses" not in result.err
    holed = rows_of(sparse, np.r_[0:30, 50:81])  # 10.5 s without truth
    assert judge("--frames", "images", truth=holed)[1]["association"]["matched"] == COUNT - 104
    assert judge("--frames", "images", "--associate", "match", truth=sparse)[0].code == 2


def test_the_images_of_the_source_are_what_has_to_be_covered(sfr: Sfr, judge: Judge, source: Path) -> None:
    stamps = np.array([loc_pair(index).stamp_ns for index in range(12)])
    positions = np.column_stack([0.02 * np.arange(12), np.zeros((12, 2))])
    whole = Trajectory(stamps, positions, np.tile([0.0, 0.0, 0.0, 1.0], (12, 1)))
    for rows, code in ((slice(12), 0), (slice(8), 3)):
        result, score = judge("--condition", "frames=3", "--spacing", 1, estimate=rows_of(whole, rows), truth=source)
        assert result.code == code, result.err
        covered = score["association"]
        assert (covered["images"], covered["matched"]) == (12, len(stamps[rows]))
        assert score_rows.number(score, "judged") == pytest.approx(len(stamps[rows]) / 12)


def test_a_score_says_what_it_was_made_of(judge: Judge) -> None:
    limits = f"{SUM}{{limit: 1, id: 4711, text: 3D position error}}\n"
    _, score = judge(limits=limits)
    verdict, provenance = score["verdicts"][0], score["provenance"]
    assert (verdict["id"], verdict["text"]) == ("4711", "3D position error")
    assert verdict["margin"] == pytest.approx(1.0 - verdict["value"])
    assert provenance["inputs"]["limits"]["sha256"] == hashlib.sha256(limits.encode()).hexdigest()
    assert provenance["command"].startswith("sfr score ")
    assert "limits.yaml" in provenance["command"]


@pytest.mark.clause("4.3.4")
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_the_error_of_every_point_can_be_had(sfr: Sfr, tmp_path: Path, source: Path, cloud: Path, suffix: str) -> None:
    points = tmp_path / f"points.{suffix}"
    result = sfr("score", cloud, source, "--points", points, "--json", "-")
    assert result.code == 0, result.err
    if suffix == "csv":
        rows = list(csv.DictReader(points.read_text().splitlines()))
        table = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    else:
        parquet = pytest.importorskip("pyarrow.parquet").read_table(points)
        table = {name: parquet[name].to_numpy() for name in parquet.column_names}
    assert list(table)[:6] == ["pair", "u", "v", "range_m", "error_m", "sigma_m"]
    offsets = np.column_stack([table[f"estimated_{axis}_m"] - table[f"true_{axis}_m"] for axis in "xyz"])
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), table["error_m"], atol=1e-12)
    errors = score_rows.row(json.loads(result.out), "point_error")
    assert len(table["u"]) == errors["n"]
    assert table["error_m"].mean() == pytest.approx(errors["mean"], abs=1e-8)
    assert table["v"].min() == SKY_ROWS  # what sees the sky has no error
    assert set(table["pair"]) == {0, 1}
    path = source / "loc" / "groundtruth.csv"
    assert sfr("score", path, path, "--points", tmp_path / f"none.{suffix}").code == 2  # no cloud


@pytest.mark.clause("4.1.1", "4.1.3", "4.2.3.1", "4.2.3.2", "4.2.3.3")
def test_each_figure_can_be_computed_again_from_the_table_of_pieces(judge: Judge, tmp_path: Path) -> None:
    """As a board does in a spreadsheet, by the standard library."""
    pieces = tmp_path / "pieces.csv"
    result, score = judge("--pieces", pieces, "--condition", "distance=5", "--condition", "time=3", "--spacing", 4)
    assert result.code == 0, result.err
    with pieces.open(newline="") as stream:
        table = list(csv.DictReader(stream))
    for condition in ("distance=5", "time=3"):
        for reading in ("pose", "displacement", "position"):
            rows = [each for each in table if (each["condition"], each["reading"]) == (condition, reading)]
            axes = [[float(each[f"error_{axis}_m"]) for each in rows] for axis in "xyz"]
            for axis, errors in zip("xyz", axes, strict=True):
                for each, error in zip(rows, errors, strict=True):
                    estimated, true = (float(each[f"{of}_displacement_{axis}_m"]) for of in ("estimated", "true"))
                    assert estimated - true == pytest.approx(error, abs=1e-12)
            where = {"condition": condition, "part": reading}
            position = score_rows.row(score, "position", **where)
            assert position["n"] == len(rows)
            assert position["mean"] == pytest.approx(math.hypot(*map(statistics.fmean, axes)), rel=1e-9)
            assert position["sigma"] == pytest.approx(math.hypot(*map(statistics.stdev, axes)), rel=1e-9)
            for figure in ("attitude", "heading"):
                errors = [float(each[f"{figure}_error_deg"]) for each in rows]
                total = abs(statistics.fmean(errors)) + 3 * statistics.stdev(errors)
                found = score_rows.number(score, figure, "mean_plus_3sigma", **where)
                assert found == pytest.approx(total, rel=1e-6, abs=1e-12)


@pytest.mark.clause("3.1.1")
@pytest.mark.parametrize("name", ["wxyz.csv", "wxyz.tum"])
def test_quaternions_with_the_scalar_first_are_named(sfr: Sfr, judge: Judge, name: str) -> None:
    truth = judge.poses("truth.csv", judge.truth)
    wrong = judge.poses(name, replace(judge.truth, quats_xyzw=judge.truth.quats_xyzw[:, [3, 0, 1, 2]]))
    result = sfr("score", wrong, truth, "--limits", judge.limits(SUM + "1000\n"))
    assert result.code == 3
    assert "quaternions are scalar first" in result.err
    assert sfr("score", wrong, truth, "--convention", "quaternion=wxyz").code == 0


def test_a_pass_that_is_not_certain_is_none_where_certainty_is_needed(judge: Judge) -> None:
    value = score_rows.number(judge()[1], "position", "mean_plus_3sigma")
    for factor, certain, code, verdict in (
        (1.01, "true", 3, "not enough data"),
        (1.01, "false", 0, "pass"),
        (10.0, "true", 0, "pass"),
        (0.99, "true", 1, "fail"),
    ):
        result, score = judge(limits=f"{SUM}{value * factor}\n  certain: {certain}\n")
        assert (result.code, score["verdicts"][0]["verdict"]) == (code, verdict)
        assert ("'certain' needs its 95 % interval within the limit" in result.err) == (code == 3)
    calls = judge.calls(judge.estimate.stamps_ns)
    result, _ = judge("--stats", calls, limits="timing:\n  localisation_max_s: {limit: 1, certain: true}\n")
    assert result.code == 3
    assert "which it does not have" in result.err


@pytest.mark.clause("4.1.1")
def test_several_conditions_hold_at_once(judge: Judge) -> None:
    """5 m take 34 frames of 0.15 m, and 4 s take 40: both hold after 40."""
    result, score = judge("--condition", "distance=5,time=4", "--condition", "time=4", "--condition", "displacement=3")
    assert result.code == 0
    both, time = (score_rows.row(score, "position", condition=each) for each in ("distance=5,time=4", "time=4"))
    assert both == time | {"condition": both["condition"]}
    assert score_rows.row(score, "position", condition="displacement=3")["n"] > 0
    for condition in ("displacement=500", "turn=170", "distance=5,time=4000"):
        result, _ = judge("--condition", condition)
        assert result.code == 3
        assert f"condition {condition}: the drive" in result.err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SUM + "1\n  id: true\n", "'id' of 'position_mean_plus_3sigma_m' is True: a text, in quotes, is required"),
        (SUM + "1\n  id: 4.10\n", "is 4.1: a text, in quotes, is required"),
        (SUM + "1\n  certain: 'yes'\n", "'certain' of 'position_mean_plus_3sigma_m' is 'yes': true or false"),
        (SUM + "{limit: 1, margin: 2}\n", "unknown key 'margin'"),
        (SUM + "{id: A}\n", "is None: a number >= 0 is required"),
        ("map:\n  missing_max_share: 0.6\n", "unknown key 'missing_max_share'"),
        ("completeness:\n  missing_max_shre: 0.6\n", "did you mean 'missing_max_share'"),
        ("completeness:\n  missing_max_share: 60\n", "a share from 0 to 1 is required"),
        ("completeness:\n  - 5\n", "a mapping of names to limits is required, found int"),
        ("completeness:\n  id: A\n", "id 'A' has no limit"),
        (SUM + "1\nmap:\n  id: R3\n  text: The map is dense.\n", "id 'R3', text 'The map is dense.' has no limit"),
        ("timing:\n  mapping_total_s: 5\n", "did you mean 'mapping_call_s'"),
    ],
)
def test_a_limits_file_that_is_not_valid_is_refused_in_one_line(judge: Judge, text: str, said: str) -> None:
    result, _ = judge(limits=text)
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert said in result.err


def test_a_difference_that_may_be_chance_is_neither_better_nor_worse(sfr: Sfr, judge: Judge) -> None:
    """One rule: the interval and p corrected for the number of comparisons have to say it both."""
    paths, rng = [], np.random.default_rng(7)
    for number in range(8):
        noise = np.cumsum(rng.normal(0.0, 0.0025 if number else 0.002, (COUNT, 3)), axis=0)
        paths.append(judge.folder / f"{number}.json")
        estimate = judge.poses("e.csv", replace(judge.truth, positions=judge.truth.positions + noise))
        options = ("--condition", "distance=1", "--json", paths[-1])
        assert sfr("score", estimate, judge.poses("t.csv", judge.truth), *options).code == 0
    result = sfr("report", *paths, "--json", "-")
    assert result.code == 0, result.err
    pairs = [item for item in json.loads(result.out)["pairs"] if item["ci95"] is not None]
    clear = [item for item in pairs if not item["ci95"][0] <= 0.0 <= item["ci95"][1]]
    assert any(item["p_corrected"] > 0.05 for item in clear)  # the interval alone would say it
    for item in pairs:
        told = item["verdict"] in ("better", "worse")
        assert told == (item in clear and item["p_corrected"] <= 0.05)


@pytest.mark.clause("4.3.4")
def test_the_judged_figure_stands_beside_its_limit(sfr: Sfr, judge: Judge, source: Path, cloud: Path) -> None:
    """A limit on p95 beside p95, on the terminal as in the JSON, not beside mean + 3 sigma."""
    limits = judge.limits("map:\n  point_error_p95_m: 0.3\n  coverage_min: 0.5\n  points_without_truth_max_share: 1\n")
    result = sfr("score", cloud, source, "--limits", limits, "--json", judge.folder / "s.json")
    score = json.loads((judge.folder / "s.json").read_text())
    p95, coverage, _ = score["verdicts"]
    assert p95["value"] == score_rows.number(score, "point_error", "p95")
    assert p95["margin"] == pytest.approx(0.3 - p95["value"])
    assert coverage["margin"] == pytest.approx(coverage["value"] - 0.5)
    row = next(line for line in result.out.splitlines() if "p95" in line and "≤" in line)
    assert "300" in row or "0.3" in row
    assert "mean + 3 sigma" not in row


def edited(score: dict[str, Any], place: str, value: Any) -> dict[str, Any]:
    """A score with another value at a place, such as `verdicts.0.verdict`."""
    made = json.loads(json.dumps(score))
    at, names = made, place.split(".")
    for name in names[:-1]:
        at = at[int(name)] if isinstance(at, list) else at[name]
    last = int(names[-1]) if isinstance(at, list) else names[-1]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return made


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        ("verdicts.0.verdict", "pass", "verdict of the verdict on position_mean_plus_3sigma_m is 'pass'"),
        ("verdicts.0.value", 0.0005, "value of the verdict on position_mean_plus_3sigma_m is 0.0005"),
        ("verdicts.0.limit", 1.0, "limit of the verdict on position_mean_plus_3sigma_m is 1"),
        ("verdict", "pass", "verdict is 'pass', from the figures follows 'fail'"),
        ("rules.limits.0.limit", 1.0, "limit of the verdict on position_mean_plus_3sigma_m is 0.001"),
        ("rules.limits.0.name", "position_mean_m", "name of the verdict on position_mean_plus_3sigma_m is"),
        ("rules.limits.0.name", "position_mode_m", "'position_mode_m' is not a limit of the part 'trajectory'"),
        ("rules.limits.0.condition", "distance=-5", "'distance=-5' is not a condition"),
        ("rules.limits", None, "it has 1 verdicts, from its figures and limits follow 0"),
        ("figures.0.mean_plus_3sigma", 0.0005, "|mean| + 3 sigma is"),
        ("verdicts.0", None, "it has 0 verdicts, from its figures and limits follow 1"),
    ],
)
def test_a_verdict_that_was_edited_is_refused_and_named(judge: Judge, place: str, value: Any, said: str) -> None:
    result, score = judge(limits=SUM + "0.001\n")
    assert result.code == 1
    path = judge.folder / "edited.json"
    path.write_text(json.dumps(edited(score, place, value)))
    for options in (("-o", judge.folder / "p.html"), ("--test-report", judge.folder / "t.html")):
        result = judge.sfr("report", path, *options, "--overwrite")
        assert result.code == 2
        assert said in result.err
        assert result.err.count("\n") == 1
    path.write_text(json.dumps(score))
    assert judge.sfr("report", path, "--overwrite").code == 1  # exits as the verdict


def test_a_score_without_its_rows_of_completeness_is_incomplete(judge: Judge) -> None:
    _, score = judge(limits=SUM + "1\n")
    assert score["verdict"] == "pass"
    of_drive = [row for row in score["figures"] if row["subject"] != "completeness"]
    beyond = [row for row in score["figures"] if row["figure"] == "errors_beyond"]
    path = judge.folder / "edited.json"
    for kept, words in ((of_drive, "errors_beyond position is absent"), ([*of_drive, *beyond], "limits follow 2")):
        path.write_text(json.dumps({**score, "figures": kept}))
        result = judge.sfr("report", path, "--overwrite")
        assert result.code == 2
        assert words in result.err


def test_a_report_keeps_the_drive_that_cannot_be_judged(judge: Judge) -> None:
    """Two drives by one limits file: that of the short one stays `not enough data`, and so does the report."""
    paths = []
    for name, rows in (("short", slice(0, 50)), ("long", slice(None))):
        estimate, truth = (rows_of(each, rows) for each in (judge.estimate, judge.truth))
        _, score = judge(limits=SUM + "1\n", estimate=estimate, truth=truth)
        paths.append(judge.folder / f"{name}.json")
        paths[-1].write_text(json.dumps(score))
    report = judge.folder / "t.html"
    result = judge.sfr("report", *paths, "--test-report", report)
    assert result.code == 3
    text = report.read_text()
    assert "<strong>NOT ENOUGH DATA</strong>" in text
    assert "1 not enough data, 1 pass" in text


def test_too_few_independent_sub_trajectories_give_no_verdict(judge: Judge) -> None:
    """17 of 5 m in 30 m overlap: they are worth four; the least number is five, unless the limits file says so."""
    estimate, truth = (rows_of(each, slice(0, 201)) for each in (judge.estimate, judge.truth))
    for least, code, verdict in (("", 3, "not enough data"), (FEW, 0, "pass")):
        result, score = judge(limits=least + SUM + "1\n", estimate=estimate, truth=truth)
        assert (result.code, score["verdicts"][0]["verdict"]) == (code, verdict)
        assert ("17 values, of which 4.25 are independent (5 are required)" in result.err) == (code == 3)


def test_a_verdict_within_the_error_of_the_truth_is_not_enough_data(judge: Judge) -> None:
    """A truth at 1 Hz of a drive that swings by 0.15 m, images at 10 Hz: interpolation is off by millimetres."""
    along = STEP_M * np.arange(COUNT)
    swing = np.column_stack([along, 0.15 * np.sin(0.07 * np.arange(COUNT)), np.zeros(COUNT)])
    true = replace(judge.truth, positions=swing)
    sparse = rows_of(true, slice(None, None, 10))
    _, score = judge("--frames", "images", limits=SUM + "1\n", estimate=true, truth=sparse)
    value = score_rows.number(score, "position", "mean_plus_3sigma")
    error = score_rows.number(score, "truth_error")
    assert score_rows.number(score, "truth_error", part="interpolation") == error
    off = np.interp(along, along[::10], swing[::10, 1]) - swing[:, 1]
    assert error == pytest.approx(float(np.sqrt(np.mean(off**2))), rel=0.2)
    assert value > 0.005  # of a perfect estimate
    allowed = "completeness:\n  missing_max_share: 1\n"
    for limit, code, verdict in ((0.8 * value, 3, "not enough data"), (1.0, 0, "pass")):
        result, score = judge("--frames", "images", limits=f"{allowed}{SUM}{limit}\n", estimate=true, truth=sparse)
        assert (result.code, score["verdicts"][0]["verdict"]) == (code, verdict)
        assert ("within the error of the truth" in result.err) == (code == 3)


def test_deviations_are_found_by_comparison_with_the_document(judge: Judge) -> None:
    """Spacing, reading, host, and what the limits allow: what was used, not what was meant."""
    calls = judge.calls(judge.estimate.stamps_ns)
    limits = f"{FEW}{SUM}1\n  missing_max_share: 0.5\ntiming:\n  localisation_max_s: 1\n"
    result, _ = judge("--spacing", "20", "--stats", calls, limits=limits)
    assert result.code == 0, result.err
    report = judge.folder / "t.html"
    options = ("--test-report", report, "--number", "TR-7", "--issue", "2")
    assert judge.sfr("report", judge.folder / "score.json", *options).code == 0
    text = report.read_text()
    for said in (
        "start every 20 frames; the document says 10",
        "by the reading &#39;pose&#39;; to the letter the document compares displacements",
        "was measured on the host; the document requires the target",
        "missing_max_share 0.5 is allowed by the limits; without it 0 is",
        "2 independent sub-trajectories are enough by the limits; without them 5 are",
        "Number TR-7, issue 2",
        "SHA-256 ",
        "kernel ",
        "<th>Independent</th>",
    ):
        assert said in text, said


# ---- rows of an audit, each as its command


LONG = 101  #: Images of the long drive, 15 m.


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 101 images whose ground truth ends after half of them, and one with the truth of all."""
    folder = tmp_path_factory.mktemp("images")
    for name, known in (("half", LONG // 2), ("all", LONG)):
        with FolderWriter(folder / name, loc=True, nav=False) as writer:
            writer.write_loc_rig(LOC_RIG)
            for index in range(LONG):
                pair = replace(loc_pair(0), stamp_ns=loc_pair(index).stamp_ns)
                if index < known:
                    writer.write_truth(pair.stamp_ns, np.array([STEP_M * index, 0.0, 0.0]), np.array([0, 0, 0, 1.0]))
                writer.write_loc_pair(pair)
    return folder


@pytest.fixture
def localised() -> Trajectory:
    """An estimate of each image of the long drive that errs by millimetres."""
    stamps = np.array([loc_pair(index).stamp_ns for index in range(LONG)], np.int64)
    noise = np.cumsum(np.random.default_rng(2).normal(0.0, 0.002, (LONG, 3)), axis=0)
    positions = noise + np.outer(STEP_M * np.arange(LONG), [1.0, 0.0, 0.0])
    return Trajectory(stamps, positions, np.tile([0.0, 0.0, 0.0, 1.0], (LONG, 1)))


ONE_M = "trajectory:\n- condition: distance=1\n  position_mean_plus_3sigma_m: 1\n"


def test_images_are_judged_only_where_there_is_a_truth(judge: Judge, images: Path, localised: Trajectory) -> None:
    """Row 112: the truth ends after half of the images."""
    for name, code, verdict in (("half", 3, "incomplete"), ("all", 0, "pass")):
        estimate = judge.poses("estimate.csv", localised)
        report = judge.folder / "of_images.json"
        report.unlink(missing_ok=True)
        limits = judge.limits(ONE_M)
        result = judge.sfr("score", estimate, images / name, "--limits", limits, "--json", report)
        score = json.loads(report.read_text())
        assert (result.code, score["verdict"]) == (code, verdict), result.err
        without = score_rows.number(score, "images_without_truth")
        assert without == (pytest.approx(0.5, abs=0.01) if code else 0.0)


@pytest.mark.parametrize("every", [5, 6])
def test_chosen_poses_are_not_the_images(judge: Judge, images: Path, localised: Trajectory, every: int) -> None:
    """Row 119: 16 or 20 poses of all, at a period of their own."""
    estimate = judge.poses("estimate.csv", rows_of(localised, slice(None, None, every)))
    result = judge.sfr("score", estimate, images / "all", "--limits", judge.limits(FEW + ONE_M))
    assert result.code == 3
    assert "% of the images" in result.err


@pytest.mark.clause("4.2.1")
@pytest.mark.parametrize(
    ("rows", "code"),
    [
        (lambda stamps: stamps, 0),
        (lambda stamps: stamps[:2], 3),
        (lambda stamps: stamps + 10**12, 3),
        (lambda stamps: np.append(stamps, np.repeat(stamps[:1], 2000)), 3),
    ],
    ids=["each image", "two images", "another run", "one image 2,001 times"],
)
def test_calls_are_those_of_the_images(judge: Judge, images: Path, localised: Trajectory, rows: Any, code: int) -> None:
    """Row 117: times of 2 of all calls, of another run, of one call many times."""
    estimate, calls = judge.poses("estimate.csv", localised), judge.calls(rows(localised.stamps_ns))
    limits = judge.limits("timing: {localisation_p95_s: 1}\n")
    assert judge.sfr("score", estimate, images / "all", "--stats", calls, "--limits", limits).code == code


@pytest.mark.clause("4.3.4")
@pytest.mark.parametrize("way", ["complete", "sky", "two points", "one pair", "not finite"])
def test_a_map_is_complete_before_it_passes(judge: Judge, source: Path, cloud: Path, way: str) -> None:
    """Row 118: points named on sky pixels, two points in all, an empty pair, points that are not finite."""
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


def test_the_ground_truth_is_not_judged_as_its_own_estimate(judge: Judge) -> None:
    """Row 121: the estimate is the truth file, or poses copied from it."""
    for copied in (judge.truth, rows_of(judge.truth, slice(None, None, 2))):
        result, score = judge(limits=SUM + "1\n", estimate=copied)
        assert (result.code, score["verdict"]) == (3, "incomplete")
        assert "100 % of the steps are those of the ground truth" in result.err
    assert judge(estimate=judge.truth)[0].code == 0  # without limits there is no verdict


def test_an_exit_code_is_the_verdict_and_a_limit_the_number_that_is_written(judge: Judge) -> None:
    """Row 123: the exit code of `sfr report`, the class of a test case, a number with a zero before it."""
    text = "timing: {localisation_max_s: 030}\ntrajectory:\n- condition: distance=5\n  position_mean_plus_3sigma_m: 0\n"
    result, score = judge("--stats", judge.calls(judge.estimate.stamps_ns), limits=text)
    assert result.code == 1
    assert [item["limit"] for item in score["verdicts"]] == [0.0, 30.0]
    path, junit = judge.folder / "score.json", judge.folder / "score.xml"
    assert judge.sfr("report", path, "--test-report", judge.folder / "t.html", "--junit", junit).code == 1
    classes = [case.attrib["classname"] for case in ElementTree.parse(junit).iter("testcase")]
    assert classes == ["sfr.4.2.3.1", "sfr.no_clause"]  # the document requires times on the target


@pytest.mark.slow
def test_a_suite_judges_every_planned_drive(sfr: Sfr, tmp_path: Path) -> None:
    """Row 113: a short drive with one bad sub-trajectory and one with none are not left out of the pool."""
    limits = {"trajectory": [{"condition": "distance=1", "position_mean_plus_3sigma_m": 0.5}], "minimum_independent": 2}
    suite = made_suite(tmp_path / "suite", 1, poses=101, limits=limits)
    content = yaml.safe_load(suite.read_text())
    good = tmp_path / "suite" / "truth0.csv"
    rows = good.read_text().splitlines(keepends=True)
    for name, count in (("one", 14), ("none", 8)):
        (tmp_path / "suite" / f"truth_{name}.csv").write_text("".join(rows[:count]))
        true = read_trajectory_file(tmp_path / "suite" / f"truth_{name}.csv").trajectory
        bad = replace(true, positions=1.9 * true.positions)
        save_trajectory(tmp_path / "suite" / f"drive_{name}.csv", bad)
    codes = {}
    for name in ("good", "one", "none"):
        added = [] if name == "good" else [{"estimate": f"drive_{name}.csv", "truth": f"truth_{name}.csv"}]
        suite.write_text(yaml.safe_dump({**content, "sources": [*content["sources"], *added]}))
        done = sfr("suite", "run", suite, "--out", tmp_path / name, "--json", "-")
        codes[name] = done.code, json.loads(done.out)["verdict"]
    assert codes["good"] == (0, "pass")
    assert codes["one"][1] in ("fail", "not enough data", "incomplete")
    assert codes["none"] == (3, codes["none"][1])
    assert codes["none"][1] in ("not enough data", "incomplete")
