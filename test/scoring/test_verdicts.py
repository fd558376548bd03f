"""Verdicts on limits, by `sfr score --limits`: certainty, too few samples, errors of the truth, invalid files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from helpers import score_rows
from helpers.cli_result import Sfr
from helpers.judge import FEW_INDEPENDENT, OVER_5_M, POSES, STEP_M, Judge
from helpers.scored_drives import COUNT, limits, straight
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory


def test_a_pass_that_is_not_certain_is_none_where_certainty_is_needed(judge: Judge) -> None:
    value = score_rows.number(judge()[1], "position", "mean_plus_3sigma")
    for factor, certain, code, verdict in (
        (1.01, "true", 3, "not enough data"),
        (1.01, "false", 0, "pass"),
        (10.0, "true", 0, "pass"),
        (0.99, "true", 1, "fail"),
    ):
        result, score = judge(limits=f"{OVER_5_M}{value * factor}\n  certain: {certain}\n")
        assert (result.code, score["verdicts"][0]["verdict"]) == (code, verdict)
        assert ("'certain' requires the complete 95 % interval to be within the limit" in result.err) == (code == 3)
    calls = judge.calls(judge.estimate.stamps_ns)
    result, _ = judge("--stats", calls, limits="timing:\n  localisation_max_s: {limit: 1, certain: true}\n")
    assert result.code == 2
    assert "'certain' requires a 95 % interval" in result.err


def test_too_few_independent_sub_trajectories_give_no_verdict(judge: Judge) -> None:
    """17 of 5 m in 30 m overlap: they are worth four; the least number is five, unless the limits file says so."""
    estimate, truth = (each[:201] for each in (judge.estimate, judge.truth))
    for least, code, verdict in (("", 3, "not enough data"), (FEW_INDEPENDENT, 0, "pass")):
        result, score = judge(limits=least + OVER_5_M + "1\n", estimate=estimate, truth=truth)
        assert (result.code, score["verdicts"][0]["verdict"]) == (code, verdict)
        assert ("17 values, of which 4.25 are independent (5 are required)" in result.err) == (code == 3)


def test_a_verdict_within_the_error_of_the_truth_is_not_enough_data(judge: Judge) -> None:
    """A truth at 1 Hz of a drive that swings by 0.15 m, images at 10 Hz: interpolation is off by millimetres."""
    along = STEP_M * np.arange(POSES)
    swing = np.column_stack([along, 0.15 * np.sin(0.07 * np.arange(POSES)), np.zeros(POSES)])
    true = replace(judge.truth, positions=swing)
    sparse = true[::10]
    _, score = judge("--frames", "images", limits=OVER_5_M + "1\n", estimate=true, truth=sparse)
    value = score_rows.number(score, "position", "mean_plus_3sigma")
    error = score_rows.number(score, "truth_error")
    assert score_rows.number(score, "truth_error", part="interpolation") == error
    off = np.interp(along, along[::10], swing[::10, 1]) - swing[:, 1]
    assert error == pytest.approx(float(np.sqrt(np.mean(off**2))), rel=0.2)
    assert value > 0.005  # of a perfect estimate
    allowed = "completeness:\n  missing_max_share: 1\n"
    for limit, code, verdict in ((0.8 * value, 3, "not enough data"), (1.0, 0, "pass")):
        result, score = judge("--frames", "images", limits=f"{allowed}{OVER_5_M}{limit}\n", estimate=true, truth=sparse)
        assert (result.code, score["verdicts"][0]["verdict"]) == (code, verdict)
        assert ("within the error of the truth" in result.err) == (code == 3)


def test_a_sequential_bound_on_unknown_errors_has_not_enough_data(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr
) -> None:
    """The truth has positions alone, so that the errors of the attitude are unknown."""
    drive = straight()
    save_trajectory(files[1], Trajectory(drive.stamps_ns, drive.positions, np.zeros((COUNT, 4))))
    bound = {"limit": 0.1, "prob": 0.5, "confidence": 0.5, "power": 0.5, "good": 0, "interpretation": "ensemble"}
    for name, code in (("position_bound_m", 0), ("attitude_bound_deg", 3)):
        content = {"minimum_independent": 1, "trajectory": [{"condition": "distance=5", name: bound}]}
        rules, score = limits(tmp_path, content), tmp_path / f"{name}.json"
        assert sfr("score", *files, "--limits", rules, "--json", score).code == code, name
        assert sfr("report", score, "-o", tmp_path / f"{name}.html").code == code, "what is written is read"


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


def test_an_exit_code_is_the_verdict_and_a_limit_the_number_that_is_written(judge: Judge) -> None:
    """The exit code of `sfr report`, the class of a test case, a number with a zero before it."""
    text = "timing: {localisation_max_s: 030}\ntrajectory:\n- condition: distance=5\n  position_mean_plus_3sigma_m: 0\n"
    result, score = judge("--stats", judge.calls(judge.estimate.stamps_ns), limits=text)
    assert result.code == 1
    assert [item["limit"] for item in score["verdicts"]] == [0.0, 30.0]
    path, junit = judge.folder / "score.json", judge.folder / "score.xml"
    assert judge.sfr("report", path, "--test-report", judge.folder / "t.html", "--junit", junit).code == 1
    classes = [case.attrib["classname"] for case in ElementTree.parse(junit).iter("testcase")]
    assert classes == ["sfr.4.2.3.1", "sfr.no_clause"]  # the document requires times on the target


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (OVER_5_M + "1\n  id: true\n", "'id' of 'position_mean_plus_3sigma_m' is True: a text in quotes is required"),
        (OVER_5_M + "1\n  id: 4.10\n", "is 4.1: a text in quotes is required"),
        (OVER_5_M + "1\n  certain: 'yes'\n", "'certain' of 'position_mean_plus_3sigma_m' is 'yes': true or false"),
        (OVER_5_M + "{limit: 1, margin: 2}\n", "unknown key 'margin'"),
        (OVER_5_M + "{id: A}\n", "is None: a number >= 0 is required"),
        ("map:\n  missing_max_share: 0.6\n", "unknown key 'missing_max_share'"),
        ("completeness:\n  missing_max_shre: 0.6\n", "did you mean 'missing_max_share'"),
        ("completeness:\n  missing_max_share: 60\n", "a fraction from 0 to 1 is required"),
        ("completeness:\n  - 5\n", "contains 5: limits as NAME: NUMBER are required"),
        ("completeness:\n  id: A\n", "id 'A' has no limit"),
        (OVER_5_M + "1\nmap:\n  id: R3\n  text: The map is dense.\n", "id 'R3', text 'The map is dense.' has no limit"),
        ("timing:\n  mapping_total_s: 5\n", "did you mean 'mapping_call_s'"),
    ],
)
def test_a_limits_file_that_is_not_valid_is_refused_in_one_line(judge: Judge, text: str, said: str) -> None:
    result, _ = judge(limits=text)
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert said in result.err
