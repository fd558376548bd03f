"""The verification control document: a row for each verdict, closed by a pass of all rows of its requirement."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from helpers.cli_result import Sfr
from helpers.made_scores import json_of, of_drive, whole_score
from sfr_loc_map.metrics.figures.records import FindingKind, FindingRecord, MethodKind, MethodRecord
from sfr_loc_map.metrics.judging.judge import judged_by, with_verdicts
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.control_document import COLUMNS, control_csv
from sfr_loc_map.report.score_tables import verdict_table
from sfr_loc_map.tables.formats import to_csv

LIMITS: dict[str, Any] = {
    "minimum_independent": 1,
    "trajectory": [
        {
            "condition": "distance=5",
            "position_mean_plus_3sigma_m": {"limit": 4.0, "id": "R1", "text": "The position, at most 4 m."},
            "attitude_mean_plus_3sigma_deg": {"limit": 1e-9, "id": "R2"},
        },
        {"condition": "distance=500", "position_mean_plus_3sigma_m": {"limit": 0.1, "id": "R3"}},
    ],
    "memory": {"localisation_peak_bytes": {"limit": 2e9, "id": "R4"}},
    "timing": {"localisation_max_s": {"limit": 1e-9, "id": "R5"}},
}


def rows_of(text: str) -> dict[str, dict[str, str]]:
    return {row["requirement"]: row for row in csv.DictReader(io.StringIO(text))}


@pytest.fixture(scope="module")
def score() -> Score:
    return judged_by(of_drive(whole_score()), parse_limits(LIMITS, "limits"))


def test_requirements_are_closed_by_a_pass_alone(score: Score) -> None:
    rows = rows_of(control_csv({"score.json": score}, "test report TR-7, issue 2"))
    assert {"R1", "R2", "R3", "R4", "R5"} <= set(rows)
    states = {item.id: item.state.value for item in score.verdicts if item.id}
    for number, state in states.items():
        assert rows[number]["close_out"] == ("closed" if state == "pass" else "open")
        assert rows[number]["compliance"] == {"pass": "compliant", "fail": "not compliant"}.get(state, "not verified")
        if state != "pass":
            assert rows[number]["remarks"]
    assert {"pass", "fail", "not enough data"} <= set(states.values())
    assert "TR-7" in rows["R1"]["evidence"]


def test_numbers_are_those_of_the_score_in_the_unit_of_the_limit(score: Score) -> None:
    row = rows_of(control_csv({"score.json": score}))["R1"]
    item = next(item for item in score.verdicts if item.id == "R1")
    assert tuple(row) == COLUMNS
    assert (float(row["limit"]), float(row["value"]), row["unit"]) == (4.0, item.value, "m")
    assert row["text"] == "The position, at most 4 m."
    assert row["clause"] == "4.2.3.1"
    memory = rows_of(control_csv({"score.json": score}))["R4"]
    assert (float(memory["limit"]), memory["unit"]) == (2e9, "bytes")


def test_the_command_writes_it_and_ends_as_the_verdict(sfr: Sfr, score: Score, tmp_path: Path) -> None:
    (tmp_path / "score.json").write_text(json.dumps(json_of(score)))
    found = sfr("report", tmp_path / "score.json", "--control", tmp_path / "vcd.csv", "--number", "TR-7")
    assert found.code == 1, "a limit is missed"
    assert rows_of((tmp_path / "vcd.csv").read_text())["R5"]["compliance"] == "not compliant"
    assert sfr("report", tmp_path / "score.json", "--control", tmp_path / "vcd.txt").code == 2


def test_scores_without_a_common_verdict_close_nothing(sfr: Sfr, score: Score, tmp_path: Path) -> None:
    other = replace(score, method=MethodRecord(name="other", version="1", kind=MethodKind.EXTERNAL))
    for name, item in (("one", score), ("two", other)):
        met = {**LIMITS, "timing": {}, "trajectory": LIMITS["trajectory"][:1]}
        met["trajectory"] = [{"condition": "distance=5", "position_mean_plus_3sigma_m": {"limit": 10.0, "id": "R1"}}]
        (tmp_path / f"{name}.json").write_text(json.dumps(json_of(judged_by(item, parse_limits(met, "limits")))))
    files = [tmp_path / "one.json", tmp_path / "two.json"]
    found = sfr("report", *files, "--control", tmp_path / "vcd.csv", "--junit", tmp_path / "junit.xml")
    assert found.code == 3
    assert {row["close_out"] for row in rows_of((tmp_path / "vcd.csv").read_text()).values()} == {"open"}
    assert 'errors="1"' in (tmp_path / "junit.xml").read_text()


@pytest.mark.parametrize("is_same_item", [True, False])
def test_a_missed_limit_of_one_score_closes_nothing_of_others(score: Score, is_same_item: bool) -> None:
    """R1 is met by one score and missed by the other one; R4 is met by both."""
    item = MethodRecord(name="mine", version="1", kind=MethodKind.EXTERNAL)
    other = item if is_same_item else replace(item, name="other")
    found = {}
    for name, limit, method in (("good.json", 10.0, item), ("bad.json", 1e-9, other)):
        position = {"limit": limit, "id": "R1"}
        content = {
            "minimum_independent": 1,
            "trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": position}],
            "memory": LIMITS["memory"],
        }
        found[name] = judged_by(replace(score, method=method), parse_limits(content, "limits"))
    rows = [row for row in csv.DictReader(io.StringIO(control_csv(found))) if row["requirement"] in ("R1", "R4")]
    states = {(row["requirement"], row["compliance"], row["close_out"]) for row in rows}
    of_memory = "closed" if is_same_item else "open"
    assert states == {("R1", "compliant", "open"), ("R1", "not compliant", "open"), ("R4", "compliant", of_memory)}
    assert all(row["remarks"] for row in rows if row["close_out"] == "open")


def test_a_score_that_failed_by_a_crash_closes_nothing(score: Score) -> None:
    crash = FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=None, text="signal 11")
    rows = rows_of(control_csv({"score.json": with_verdicts(replace(score, findings=(crash,)))}))
    assert rows["R1"]["compliance"] == "compliant"
    assert {row["close_out"] for row in rows.values()} == {"open"}
    assert "signal 11" in rows["R1"]["remarks"]


def test_a_row_has_its_own_deviations_and_the_first_row_those_of_the_score(score: Score) -> None:
    timing = {"timing": {"localisation_max_s": {"limit": 100.0, "id": "R5"}}, "memory": LIMITS["memory"]}
    met = replace(judged_by(score, parse_limits(timing, "limits")), incomplete="the estimate covers 90 %")
    rows = list(csv.DictReader(io.StringIO(control_csv({"score.json": met}))))
    assert ["90 %" in row["remarks"] for row in rows] == [True, *([False] * (len(rows) - 1))]
    for number, other in (("R4", "R5"), ("R5", "R4")):
        (own,) = (row for row in rows if row["requirement"] == number)
        assert f"{number}: " in own["remarks"]
        assert f"{other}: " not in own["remarks"]


def test_a_count_is_that_of_the_row_if_the_verdict_has_none(score: Score) -> None:
    counts = {item.id: item.n for item in score.verdicts}
    assert counts["R4"] is None
    row = score.row_of(next(item for item in score.verdicts if item.id == "R4"))
    assert row is not None
    assert rows_of(control_csv({"score.json": score}))["R4"]["n"] == str(row.n)


@pytest.mark.parametrize("text", ["=1+1", "@SUM(A1)", "+1", "-1"])
def test_a_text_is_no_formula_of_a_spreadsheet(score: Score, text: str) -> None:
    verdicts = tuple(replace(item, text=text) for item in score.verdicts)
    made = replace(score, verdicts=verdicts)
    assert {row["text"] for row in rows_of(control_csv({"score.json": made})).values()} == {f"'{text}"}
    named = replace(score, verdicts=tuple(replace(item, id=text) for item in score.verdicts))
    assert f",'{text}\n" in to_csv([verdict_table(named)])


def test_a_pass_with_deviations_names_them(score: Score) -> None:
    lost = replace(score, incomplete="the estimate covers 90 %")
    rows = rows_of(control_csv({"score.json": lost}))
    assert rows["R1"]["close_out"] == "closed"
    assert "90 %" in rows["R1"]["remarks"]
