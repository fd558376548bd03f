"""Evidence in a test report: the files of check, budget and search, in a fixed order and without a verdict."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from helpers.cli_result import Sfr
from helpers.made_scores import json_of, whole_score
from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence.agreement import Agreement, agreement_rows
from sfr_loc_map.evidence.overlap import Overlap, overlap_rows
from sfr_loc_map.evidence.report_evidence import read_evidence
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.metrics.figures.records import InputFile
from sfr_loc_map.metrics.stored.score_json import HASH, hash_of_values, to_plain
from sfr_loc_map.report.test_report import render_test_report
from sfr_loc_map.suite.pages.search_page import render_search
from sfr_loc_map.suite.search.record import SearchRecord
from sfr_loc_map.suite.statistics.budget import Budget, BudgetFigure, BudgetRow

COVERED = {"pairs": {"drive": 600, "maps": 2}, "pairs_of_source": {"drive": 3000, "maps": 2}}


def write(path: Path, content: dict[str, Any]) -> Path:
    """Write a file with the hash of its values, as `sfr check` does."""
    path.write_text(json.dumps(content | {HASH: hash_of_values(content)}))
    return path


def check_file(folder: Path) -> Path:
    overlap = Overlap(0, 1, 0.4, 5000, 0.0125, 2.5, 0.2)
    agreement = Agreement(
        runs=("forward", "backward"),
        condition="distance=1",
        position_m=np.ones((3, 3)),
        attitude_deg=np.ones(3),
        squares=np.array([5.0, 6.0, 7.0]),
        independent=3,
    )
    content = {"schema": "sfr-check/1", "result": "inconsistent", "results": {"drive": "consistent"}}
    content["results"]["maps"] = "inconsistent"
    figures = to_plain((*agreement_rows(agreement), *overlap_rows(overlap)))
    return write(folder / "check.json", content | {"calibration": ["yaw is off"], "figures": figures} | COVERED)


def budget_file(folder: Path, total: BudgetFigure) -> Path:
    row = BudgetRow(
        source="<b>noise</b>",
        alone=BudgetFigure(0.75, (0.5, 1.0)),
        removed=BudgetFigure(0.5),
        interaction=BudgetFigure(0.0),
        mean_m=(0.0, 0.0, 0.0),
        sigma_m=(0.001, 0.0, 0.0),
    )
    budget = Budget(
        configuration="default",
        condition="distance=5",
        drives=6,
        left_out=1,
        rms_m=0.01,
        rows=(row,),
        rest=BudgetFigure(0.25),
        total=total,
    )
    return write(folder / "suite.json", {"schema": "sfr-suite/1", "budgets": [to_plain(budget)]})


def search_file(folder: Path, *ratios: float) -> Path:
    points = [{"ratio": ratio, "point": {"light": 10.0 * ratio}} for ratio in ratios]
    worst = max(points, key=lambda item: item["ratio"])
    content = {"schema": "sfr-search/2", "figure": "position", "statistic": "mean_plus_3sigma", "limit": 0.1}
    content |= {"condition": "distance=5"}
    content |= {"parameters": [{"name": "light", "low": 1.0, "high": 60.0, "usual": 5.0}]}
    return write(
        folder / "search.json", content | {"points": points, "usual": points[0], "found": worst, "case": worst}
    )


def test_an_unchanged_scenario_that_alone_misses_the_limit_is_an_open_point(tmp_path: Path) -> None:
    path = search_file(tmp_path, 0.5)
    content = json.loads(path.read_text())
    usual = {"ratio": 1.25, "point": {"light": 5.0}}
    (evidence,) = read_evidence([write(path, content | {"usual": usual, "found": usual, "case": usual})])
    (text,) = evidence.open_points
    assert "0 of 1 searched scenarios and in the unchanged scenario" in text
    record = msgspec.json.decode(path.read_bytes(), type=SearchRecord)
    assert "FAIL" in render_search(record)


def test_evidence_is_in_the_order_of_a_review_with_its_open_points(tmp_path: Path) -> None:
    paths = [
        search_file(tmp_path, 0.5, 1.5),
        budget_file(tmp_path, BudgetFigure(0.8, (0.7, 0.9))),
        check_file(tmp_path),
    ]
    found = read_evidence(paths)
    assert [item.heading for item in found] == ["Check without ground truth", "Error budget", "Worst case"]
    assert [item.sha256 for item in found] == [hash_path(path) for path in reversed(paths)]
    check, budget, search = (" ".join(item.open_points) for item in found)
    assert "maps" in check
    assert "check of the drive without ground truth is" not in check
    assert "the drive without ground truth covers 600 of 3000 pairs" in check
    assert "the maps without ground truth covers" not in check
    assert "yaw is off" in check
    assert "over 5 m: 1." in budget
    assert "interact" in budget
    assert "1 of 2 searched scenarios" in search
    assert "1.5 times" in search
    _, overlap = found[0].tables
    assert overlap.rows[0][3].value == 0.0125
    assert [cell.value for cell in found[2].tables[0].rows[0]] == [None, 1.0, 60.0, 5.0, 15.0, 15.0]


def test_evidence_without_a_problem_leaves_no_point_open(tmp_path: Path) -> None:
    content = json.loads(check_file(tmp_path).read_text())
    content |= {"results": {"drive": "consistent"}, "calibration": []}
    content["figures"] = [row for row in content["figures"] if not row["figure"].startswith("overlap")]
    content |= {"pairs": {"drive": 600}, "pairs_of_source": {"drive": 600}}
    paths = [write(tmp_path / "good.json", content), search_file(tmp_path, 0.5, 0.9)]
    assert [item.open_points for item in read_evidence(paths)] == [(), ()]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("{", "JSON"),
        ('{"schema": "sfr-score/2"}', "sfr-score/2"),
        ('{"schema": []}', r"its schema is \[\]"),
        ("{}", "its schema is None"),
        ("[]", "object"),
        ('{"schema": "sfr-search/2"}', "figure"),
        ('{"schema": "sfr-search/1"}', "sfr-search/1"),
    ],
)
def test_another_file_is_refused(tmp_path: Path, content: str, problem: str) -> None:
    path = tmp_path / "e.json"
    path.write_text(content)
    with pytest.raises(InputError, match=problem) as caught:
        read_evidence([path])
    assert "give the JSON of sfr check" in str(caught.value)


def edited(content: dict[str, Any], figure: str, **numbers: float) -> dict[str, Any]:
    figures = [row | numbers if row["figure"] == figure else row for row in content["figures"]]
    return content | {"figures": figures}


def test_a_check_without_its_hash_is_refused(tmp_path: Path) -> None:
    content = json.loads(check_file(tmp_path).read_text())
    path = tmp_path / "edited.json"
    path.write_text(json.dumps(content | {"calibration": []}))
    with pytest.raises(InputError, match=HASH):
        read_evidence([path])


def test_the_report_states_the_result_of_a_check_and_its_comparisons(tmp_path: Path) -> None:
    (evidence,) = read_evidence([check_file(tmp_path)])
    assert evidence.results[0] == "drive: consistent; 1 of 1 comparisons have enough data."
    assert evidence.results[0] in render_test_report([whole_score()], evidence=[evidence])
    short = {"schema": "sfr-check/1", "figures": [], "pairs": {"drive": 10}, "pairs_of_source": {"drive": 10}}
    (evidence,) = read_evidence([write(tmp_path / "short.json", short)])
    assert "0 of 0 comparisons" in evidence.results[0]
    assert "not enough data" in evidence.open_points[0]


@pytest.mark.parametrize("case", ["probability", "result", "ratio", "calibration", "missing"])
def test_the_results_of_a_check_are_derived_from_its_figures(tmp_path: Path, case: str) -> None:
    content = json.loads(check_file(tmp_path).read_text())
    changed, result = {
        "probability": (edited(content, "agreement", value=1e-12), "drive: inconsistent"),
        "result": (content | {"results": {"drive": "not enough data"}}, "drive: consistent"),
        "ratio": (edited(content, "overlap_ratio", value=1.0), "maps: consistent"),
        "calibration": (content | {"advice": {"pitch": "redo"}}, "calibration: inconsistent"),
        "missing": (content | {"results": {}}, "maps: inconsistent"),
    }[case]
    (evidence,) = read_evidence([write(tmp_path / "edited.json", changed)])
    assert any(text.startswith(result) for text in evidence.results)


def test_a_file_is_given_once(tmp_path: Path) -> None:
    path = check_file(tmp_path)
    copy = write(tmp_path / "copy.json", json.loads(path.read_text()))
    with pytest.raises(InputError, match="give each evidence once"):
        read_evidence([path, copy])


@pytest.mark.parametrize("recording", ["of the score", "other", "unknown"])
def test_a_check_of_another_recording_is_an_open_point(tmp_path: Path, recording: str) -> None:
    made = whole_score().provenance
    assert made is not None
    source = InputFile(path="data", sha256="1" * 64)
    score = replace(whole_score(), provenance=replace(made, inputs={"images": source}))
    other = {"of the score": source, "other": replace(source, sha256="2" * 64)}
    content = json.loads(check_file(tmp_path).read_text())
    if recording in other:
        content["provenance"] = to_plain(replace(made, inputs={"images": other[recording]}))
    page = render_test_report([score], evidence=read_evidence([write(tmp_path / "made.json", content)]))
    assert ("no recording in common" in page) is (recording == "other")
    assert ("recording of the evidence" in page) is (recording == "unknown")


def test_a_check_without_a_figure_of_a_line_is_refused(tmp_path: Path) -> None:
    content = json.loads(check_file(tmp_path).read_text())
    content["figures"] = [row for row in content["figures"] if row["figure"] != "overlap_ratio"]
    path = write(tmp_path / "cut.json", content)
    with pytest.raises(InputError, match="overlap_ratio") as caught:
        read_evidence([path])
    assert str(path) in str(caught.value)


def test_the_test_report_shows_the_evidence_and_keeps_the_verdict(sfr: Sfr, tmp_path: Path) -> None:
    score = tmp_path / "score.json"
    score.write_text(json.dumps(json_of(whole_score())))
    plain, shown = tmp_path / "plain.html", tmp_path / "shown.html"
    paths = [search_file(tmp_path, 0.5, 1.5), budget_file(tmp_path, BudgetFigure(1.0)), check_file(tmp_path)]
    options = [word for path in paths for word in ("--evidence", path)]
    usual = sfr("report", score, "--test-report", plain)
    found = sfr("report", score, "--test-report", shown, *options)
    assert found.code == usual.code
    headings = re.findall(r"<h2>(\d+) ([^<]+)</h2>", shown.read_text())
    assert [int(number) for number, _ in headings] == list(range(1, len(headings) + 1))
    assert [text for _, text in headings][4:8] == ["Results", "Additional evidence", "Deviations", "Anomalies"]
    assert "Additional evidence" not in plain.read_text()
    assert "<b>noise" not in shown.read_text()
    assert hash_path(paths[0]) in shown.read_text()
    alone = sfr("report", score, "-o", tmp_path / "page.html", *options)
    assert alone.code == 2
    assert "--test-report" in alone.err
