"""The table of exit codes: a verdict, invalid input, and a run that could not be judged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from helpers import ROOT
from helpers.cli_result import Sfr
from sfr_loc_map.cli.verdict import conclude
from sfr_loc_map.errors import ExitCode, FailedVerdictError, OutputError
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_normalised
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.figures.records import FindingKind, FindingRecord
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.score.score import Score

SECOND_NS = 1_000_000_000
CODES = ROOT / "docs" / "operating.md"


def drive(count: int = 25, *, offset_m: float = 0.0) -> Trajectory:
    """A curved drive of half a metre a second; the estimate of it errs by little."""
    turn = 0.05 * np.arange(count)
    tilt = np.full(count, 0.02)
    heading = quat_normalised(np.column_stack((tilt, tilt, np.sin(turn / 2), np.cos(turn / 2))))
    steps = 0.5 * np.column_stack((np.cos(turn), np.sin(turn), 0.1 * np.sin(3 * turn)))
    positions = np.cumsum(np.vstack((np.zeros(3), steps[:-1])), axis=0)
    noise = offset_m * np.random.default_rng(3).normal(size=(count, 3))
    return Trajectory(np.arange(count, dtype=np.int64) * SECOND_NS, positions + noise, heading)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """An estimate and the truth, 12 m long."""
    estimate, truth = tmp_path / "estimate.csv", tmp_path / "truth.csv"
    save_trajectory(estimate, drive(offset_m=0.001))
    save_trajectory(truth, drive())
    return estimate, truth


def limits_file(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("condition", "reason"),
    [
        ("distance=50", "condition distance=50: the drive is 12.0 m long"),
        ("time=60", "condition time=60: the drive lasts 24.0 s"),
        ("frames=100", "condition frames=100: the drive has 25 frames"),
        ("distance=50,time=60", "condition distance=50,time=60: the drive is 12.0 m long and lasts 24.0 s"),
        ("displacement=12", "condition displacement=12: the drive never reaches this straight-line distance"),
        ("turn=170", "condition turn=170: the drive never turns by this angle"),
        ("distance=5,time=60", "condition distance=5,time=60: the drive lasts 24.0 s"),
        ("distance=50,turn=1", "condition distance=50,turn=1: the drive is 12.0 m long"),
        ("distance=5,turn=170", "condition distance=5,turn=170: no sub-trajectory of the drive meets all its parts"),
    ],
)
def test_a_condition_that_the_drive_never_meets_is_not_judged(
    sfr: Sfr, files: tuple[Path, Path], condition: str, reason: str
) -> None:
    result = sfr("score", *files, "--condition", condition, "--condition", "distance=5")
    assert result.code == ExitCode.NOT_JUDGED
    (line,) = result.err.splitlines()
    assert line.startswith("sfr: not judged: ")
    assert reason in line
    assert "--lenient" in line
    assert "position error over 5 m" in result.out
    lenient = sfr("score", *files, "--condition", condition, "--lenient")
    assert lenient.code == 0
    assert f"sfr: warning: not judged: {reason}" in lenient.err


def test_exit_code_and_verdict_of_the_score_agree_on_a_condition_without_a_limit(
    sfr: Sfr, tmp_path: Path, files: tuple[Path, Path]
) -> None:
    text = "minimum_independent: 2\ntrajectory:\n  - condition: distance=5\n    position_mean_m: 10\n"
    limits, score = limits_file(tmp_path / "limits.yaml", text), tmp_path / "s.json"
    conditions = ("--condition", "distance=50", "--condition", "distance=5")
    result = sfr("score", *files, "--limits", limits, *conditions, "--json", score)
    assert json.loads(score.read_text())["verdict"] == "pass"
    assert result.code == 0
    assert "sfr: warning: not judged: condition distance=50: the drive is 12.0 m long" in result.err
    assert sfr("report", score, "--overwrite").code == 0


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ("map:\n  coverage_min: 0.5\n", "limit coverage_min: no data"),
        ("timing:\n  localisation_p95_s: 0.5\n", "limit localisation_p95_s: no data"),
        (
            "minimum_count: 100\ntrajectory:\n  - condition: distance=2\n    heading_mean_deg: 1\n",
            "limit heading_mean_deg over 2 m: too few values",
        ),
        (
            "trajectory:\n  - condition: distance=50\n    heading_mean_deg: 1\n    position_mean_m: 1\n",
            "condition distance=50: the drive is 12.0 m long",
        ),
    ],
)
def test_a_limit_without_data_is_not_judged(
    sfr: Sfr, tmp_path: Path, files: tuple[Path, Path], limits: str, reason: str
) -> None:
    path = limits_file(tmp_path / "limits.yaml", limits)
    result = sfr("score", *files, "--limits", path)
    assert result.code == ExitCode.NOT_JUDGED
    assert reason in result.err
    assert result.err.count(reason) == 1
    assert sfr("score", *files, "--limits", path, "--lenient").code == 0


def test_a_missed_limit_counts_before_one_without_data(sfr: Sfr, tmp_path: Path, files: tuple[Path, Path]) -> None:
    text = "trajectory:\n  - condition: distance=5\n    position_mean_m: 0\nmap:\n  coverage_min: 0.5\n"
    text += "minimum_independent: 2\n"
    result = sfr("score", *files, "--limits", limits_file(tmp_path / "limits.yaml", text))
    assert result.code == ExitCode.FAILED
    assert result.err.startswith("sfr: 1 of 2 limits missed")


def mismatched(kind: str) -> Trajectory:
    whole = drive(60)
    if kind == "conjugated":
        return Trajectory(whole.stamps_ns, whole.positions, quat_conjugate(whole.quats_xyzw))
    if kind == "wxyz":
        return Trajectory(whole.stamps_ns, whole.positions, np.roll(whole.quats_xyzw, 1, axis=1))
    return Trajectory(whole.stamps_ns, 1000.0 * whole.positions, whole.quats_xyzw)


@pytest.mark.parametrize("kind", ["conjugated", "wxyz", "millimetres"])
def test_a_convention_mismatch_judges_nothing_and_is_a_finding_of_the_doctor(
    sfr: Sfr, tmp_path: Path, kind: str
) -> None:
    estimate, truth, report = tmp_path / "estimate.csv", tmp_path / "truth.csv", tmp_path / "s.json"
    save_trajectory(estimate, mismatched(kind))
    save_trajectory(truth, drive(60))
    limits = limits_file(tmp_path / "l.yaml", "trajectory:\n  - condition: distance=5\n    position_mean_m: 0.01\n")
    result = sfr("score", estimate, truth, "--limits", limits, "--json", report)
    assert result.code == ExitCode.NOT_JUDGED
    (line,) = result.err.splitlines()
    assert line.startswith("sfr: not judged: the estimate looks wrong: ")
    score = json.loads(report.read_text())
    assert score["contradiction"] in line
    assert score["warnings"] == [score["contradiction"]]
    page = tmp_path / "page.html"
    assert sfr("report", report, "-o", page).code == ExitCode.NOT_JUDGED
    assert "Not judged: the estimate looks wrong" in page.read_text()
    found = sfr("score", estimate, truth, "--diagnose")
    assert found.code == ExitCode.FAILED
    assert "estimate and truth use different conventions" in found.err
    assert "the estimate looks wrong" in found.out


@pytest.mark.parametrize(("lag_s", "code", "verdict"), [(0.1, ExitCode.OK, "pass"), (0.3, ExitCode.FAILED, "fail")])
def test_a_late_method_is_judged_as_delivered_and_its_offset_is_a_finding(
    sfr: Sfr, tmp_path: Path, lag_s: float, code: int, verdict: str
) -> None:
    """The mean + 3 sigma over 5 m is 0.23 m with the short lag, and three times as large with the long lag."""
    estimate, truth, report = tmp_path / "estimate.csv", tmp_path / "truth.csv", tmp_path / "s.json"
    save_trajectory(truth, winding_drive(0.0))
    save_trajectory(estimate, winding_drive(lag_s))
    text = "trajectory:\n  - condition: distance=5\n    position_mean_plus_3sigma_m: 0.4\n"
    result = sfr("score", estimate, truth, "--limits", limits_file(tmp_path / "l.yaml", text), "--json", report)
    score = json.loads(report.read_text())
    assert (result.code, score["verdict"]) == (code, verdict), result.err
    assert f"add -{lag_s:.3f} s" in " ".join(score["warnings"])
    assert score.get("contradiction") is None
    assert sfr("score", estimate, truth, "--diagnose").code == ExitCode.FAILED


def winding_drive(lag_s: float) -> Trajectory:
    """Return the poses at 10 Hz of a drive of 60 m at changing speed, delivered with a delay."""
    fine_s = np.arange(-2.0, 202.0, 0.01)
    yaw, speed = 0.8 * np.sin(0.2 * fine_s), 0.3 + 0.2 * np.sin(0.5 * fine_s)
    tilt = 0.02 * np.sin(0.7 * fine_s)
    path = 0.01 * np.cumsum(speed[:, None] * np.column_stack((np.cos(yaw), np.sin(yaw), tilt)), axis=0)
    delivered_s = 0.1 * np.arange(2000) - lag_s
    x, y, z, heading, lean = (np.interp(delivered_s, fine_s, values) for values in (*path.T, yaw, tilt))
    quats = quat_normalised(np.column_stack((lean, lean, np.sin(0.5 * heading), np.cos(0.5 * heading))))
    return Trajectory(np.arange(2000) * SECOND_NS // 10, np.column_stack((x, y, z)), quats)


def test_the_error_of_a_failed_method_states_a_contradiction_too() -> None:
    crash = FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=None, text="signal 11")
    score = judged_by(Score(contradiction="its quaternions are conjugated", findings=(crash,)), None)
    with pytest.raises(FailedVerdictError, match="the method failed: crashed; not judged: its quaternions are conj"):
        conclude(score, (), lenient=False)


@pytest.mark.parametrize(
    "words",
    [
        ("score", "{estimate}", "{truth}", "--limits", "{limits}", "--html", "{page}"),
        ("report", "{score}", "--test-report", "{page}"),
    ],
)
def test_an_output_that_cannot_be_written_gives_exit_code_2_after_the_others_are_written(
    sfr: Sfr, files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    def fail(*_: object) -> None:
        raise OutputError("cannot write 'verdicts.xml': no space left")

    limits = limits_file(
        tmp_path / "limits.yaml", "minimum_independent: 2\ntrajectory: [{condition: distance=5, position_mean_m: 1}]\n"
    )
    page, score = tmp_path / "page.html", tmp_path / "score.json"
    assert sfr("score", *files, "--limits", limits, "--json", score).code == 0
    places = {"estimate": files[0], "truth": files[1], "limits": limits, "page": page, "score": score}
    monkeypatch.setattr("sfr_loc_map.cli.verdict.write_text", fail)
    result = sfr(*(word.format(**places) for word in words), "--junit", tmp_path / "verdicts.xml")
    assert result.code == ExitCode.BAD_INPUT
    assert "sfr: warning: cannot write 'verdicts.xml'" in result.err
    assert page.is_file()


@pytest.mark.parametrize("has_earlier_outputs", [False, True])
def test_an_interruption_names_the_outputs_that_were_finished(
    sfr: Sfr, files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_earlier_outputs: bool
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sfr_loc_map.report.page.write_page", interrupt)
    score, page = tmp_path / "score.json", tmp_path / "page.html"
    for path in (score, page) if has_earlier_outputs else ():
        path.write_text("{}")
    result = sfr("score", *files, "--json", score, "--html", page, "--overwrite")
    assert result.code == ExitCode.INTERRUPTED
    assert result.err.splitlines()[-1] == f"sfr: interrupted: {score} was finished"


def test_the_table_is_in_the_help_and_in_the_docs(sfr: Sfr) -> None:
    text = " ".join(sfr("--help").out.split())
    table = CODES.read_text(encoding="utf-8")
    for code in ExitCode:
        assert f" {code:d} " in text
        assert f"| {code:d} |" in table
