"""Options and outputs of `sfr score`: conditions, readings, conventions, tables of all errors, provenance."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import statistics
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers import score_rows
from helpers.cli_result import Sfr
from helpers.judge import OVER_5_M, POSES, SKY_ROWS, STEP_M, Judge
from helpers.made_scene import write_folder
from helpers.scored_drives import POSITION, limits, straight
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.judging.several_scores import difference_of
from sfr_loc_map.metrics.stored.score_json import load_score


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


@pytest.mark.clause("4.1.2", "4.2.3.1", "4.2.3.2", "4.2.3.3")
def test_the_readings_differ_under_drift_and_the_result_says_which_verdict_they_decide(judge: Judge) -> None:
    """0.1 deg/m over 60 m: `pose` is small, the displacement in DS turns with the heading, `position` counts all."""
    drift = Rotation.from_euler("z", (0.1 * STEP_M * np.arange(POSES))[:, None], degrees=True)
    turned = (drift * judge.heading).as_quat()
    drifting = replace(judge.truth, positions=np.cumsum(drift.apply(judge.steps), axis=0), quats_xyzw=turned)
    result, score = judge(limits=OVER_5_M + "0.3\n  attitude_mean_plus_3sigma_deg: 1\n", estimate=drifting)
    readings = ("pose", "displacement", "position")
    position = {name: score_rows.number(score, "position", "mean_plus_3sigma", part=name) for name in readings}
    attitude = {name: score_rows.number(score, "attitude", "mean_plus_3sigma", part=name) for name in readings}
    assert position["pose"] < 0.05
    assert position["displacement"] == pytest.approx(position["position"], abs=1e-9)
    assert position["displacement"] > 0.7
    assert attitude["pose"] == pytest.approx(attitude["displacement"], abs=1e-6)
    assert attitude["position"] > 8.0
    assert score["verdicts"][0]["by_reading"] == {"pose": "pass", "displacement": "fail", "position": "fail"}
    assert "2 of 2 verdicts depend on the reading" in result.err
    for reading, code in (("pose", 0), ("displacement", 1), ("position", 1)):
        result, score = judge("--rebase", reading, limits=OVER_5_M + "0.3\n", estimate=drifting)
        assert (result.code, score["association"]["rebase"]) == (code, reading)
        assert score["verdicts"][0]["value"] == position[reading]
    assert "decides" not in judge(limits=OVER_5_M + "5\n", estimate=drifting)[0].err


@pytest.mark.clause("3.1.1")
@pytest.mark.parametrize("name", ["wxyz.csv", "wxyz.tum"])
def test_quaternions_with_the_scalar_first_are_named(sfr: Sfr, judge: Judge, name: str) -> None:
    truth = judge.poses("truth.csv", judge.truth)
    wrong = judge.poses(name, replace(judge.truth, quats_xyzw=judge.truth.quats_xyzw[:, [3, 0, 1, 2]]))
    result = sfr("score", wrong, truth, "--limits", judge.limits(OVER_5_M + "1000\n"))
    assert result.code == 3
    assert "quaternions are scalar first" in result.err
    assert sfr("score", wrong, truth, "--convention", "quaternion=wxyz").code == 0


def test_a_factor_that_is_no_unit_of_length_judges_nothing(tmp_path: Path, sfr: Sfr) -> None:
    rules = limits(tmp_path, POSITION)
    save_trajectory(tmp_path / "t.csv", straight())
    for factor, code in ((1.0 / 1.1, 3), (1.00001, 3), (0.001, 0), (0.3048, 0), (1200 / 3937, 0)):
        save_trajectory(tmp_path / "e.csv", straight(scale=0.999 / factor))
        options = ("--convention", f"metres_per_unit={factor!r}", "--limits", rules)
        done = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", *options)
        assert done.code == code, (factor, done.err)
        assert ("is not a unit of length" in done.err) == (code == 3)


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


def test_a_score_says_what_it_was_made_of(judge: Judge) -> None:
    limits = f"{OVER_5_M}{{limit: 1, id: 4711, text: 3D position error}}\n"
    _, score = judge(limits=limits)
    verdict, provenance = score["verdicts"][0], score["provenance"]
    assert (verdict["id"], verdict["text"]) == ("4711", "3D position error")
    assert verdict["margin"] == pytest.approx(1.0 - verdict["value"])
    assert provenance["inputs"]["limits"]["sha256"] == hashlib.sha256(limits.encode()).hexdigest()
    assert provenance["command"].startswith("sfr score ")
    assert "limits.yaml" in provenance["command"]


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
        found.append(load_score(tmp_path / f"{number}.json"))
    inputs = [score.provenance.inputs for score in found if score.provenance is not None]
    assert [len({item[role].sha256 for item in inputs}) for role in ("truth", "images")] == [1, 3]
    assert difference_of(found) == "the scores come from several sets of images, which only a suite judges together"
    sfr("report", tmp_path / "0.json", "--test-report", page)
    assert inputs[0]["images"].sha256 in page.read_text()
