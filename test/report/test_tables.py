import copy
import csv
import io

import pytest
from made_scores import HOSTILE, whole_score

from sfr_loc_map.report.cells import Table, condition_text, dig, number
from sfr_loc_map.report.score_tables import limit_name, score_tables
from sfr_loc_map.report.tables import to_csv, to_markdown


def table(score: dict, name: str) -> Table:
    return next(item for item in score_tables(score) if item.name == name)


def texts(row: tuple) -> list[str]:
    return [cell.text for cell in row]


SMALL = {
    "schema": "sfr-score/1",
    "trajectory": {
        "count": 31,
        "condition": {"distance_m": 5.0},
        "position_m": {
            "mean": 0.0123456, "sigma": 0.002, "mean_plus_3sigma": 0.0183456, "mean_plus_3sigma_ci95": [0.015, 0.025],
        },
        "attitude_deg": {"mean": None, "sigma": None, "mean_plus_3sigma": None, "mean_plus_3sigma_ci95": None},
        "heading_deg": {"mean": -0.5, "sigma": 0.1, "mean_plus_3sigma": 0.8, "mean_plus_3sigma_ci95": None},
    },
    "memory": {"localisation_peak_bytes": 524288000, "method": "by hand"},
    "verdicts": [
        {"metric": "position_mean_plus_3sigma_m", "condition": {"distance_m": 5.0}, "limit": 0.02, "value": 0.0183456,
         "ci95": [0.015, 0.025], "count": 31, "verdict": "pass", "certain": False},
        {"metric": "localisation_peak_bytes", "limit": 1048576, "value": 524288000, "ci95": None, "verdict": "fail"},
        {"metric": "coverage_min", "limit": 0.8, "value": None, "ci95": None, "verdict": "not enough data"},
    ],
}  # fmt: skip


def test_headline_row_by_hand() -> None:
    rows = table(SMALL, "headline").rows
    assert texts(rows[0]) == ["position error over 5 m", "m", "0.01235", "0.002", "0.01835", "0.015 to 0.025", "31"]
    assert rows[0][4].value == 0.0183456
    assert rows[0][4].key == "trajectory.position_m.mean_plus_3sigma"


def test_undefined_figures_are_words() -> None:
    assert texts(table(SMALL, "headline").rows[1])[2:5] == ["not enough data"] * 3


def test_verdict_rows_by_hand() -> None:
    rows = [texts(row) for row in table(SMALL, "verdicts").rows]
    assert rows[0] == [
        "pass", "position mean + 3 sigma, over 5 m", "m", "≤ 0.02", "0.01835", "0.015 to 0.025", "31", "no",
    ]  # fmt: skip
    assert rows[1][1:5] == ["localisation peak", "MiB", "≤ 1", "500"]
    assert rows[2][1:5] == ["map coverage", "share", "≥ 0.8", "not enough data"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.000123456, "0.0001235"),
        (12345.6, "12346"),
        (7, "7"),
        (2_292_689, "2292689"),
        (None, "unknown"),
        (-0.5, "-0.5"),
    ],
)
def test_number(value: float | None, text: str) -> None:
    assert number(value) == text


def test_names() -> None:
    assert condition_text({"time_s": 60.0}) == "60 s"
    assert limit_name("mapping_p95_s") == "mapping time p95"
    assert limit_name("point_error_p95_m") == "point error p95"
    assert limit_name("localisation_above_idle_bytes") == "localisation above idle"


def test_every_cell_leads_back_to_its_figure() -> None:
    score = whole_score()
    cells = [cell for item in score_tables(score) for row in item.rows for cell in row if cell.key]
    assert len(cells) > 150
    for cell in cells:
        found = dig(score, cell.key)
        assert cell.value == (None if isinstance(found, list) else found), cell


def test_all_rows_are_as_long_as_the_head() -> None:
    for item in score_tables(whole_score()):
        assert {len(row) for row in item.rows} == {len(item.columns)}, item.name


def test_csv_holds_the_exact_figures() -> None:
    score = whole_score()
    rows = list(csv.DictReader(io.StringIO(to_csv(score))))
    keys = {row["key"]: row["value"] for row in rows if row["key"]}
    for key, text in keys.items():
        value = dig(score, key)
        assert (float(text) if text else None) == value, key
    place = "trajectory.conditions.0.position_m.mean_plus_3sigma_ci95"
    assert float(keys[f"{place}.1"]) == dig(score, place)[1]
    assert [row["value"] for row in rows if row["column"] == "verdict"] == ["fail", "pass", "not enough data", "pass"]


def test_markdown_tables_keep_their_shape() -> None:
    score = copy.deepcopy(whole_score())
    score["memory"]["method"] = f"a | b {HOSTILE}"
    text = to_markdown(score)
    assert "<script" not in text.replace("\\<", "")
    assert "✖ fail" in text
    blocks = [block for block in text.split("\n\n") if block.startswith("|")]
    assert len(blocks) == len(score_tables(score))
    for block in blocks:
        lines = [line.replace("\\|", "") for line in block.splitlines()]
        assert len({line.count("|") for line in lines}) == 1, block
    assert "nan" not in text.lower().replace("covariance", "").split()


def test_a_map_without_pixels_is_named_so() -> None:
    score = {"map": {"nearest_only": True, "nearest_distance_m": {"count": 3, "mean": 0.1, "sigma": 0.1}, "points": 3}}
    assert texts(table(score, "headline").rows[0])[0] == "map: distance to the nearest true point"
