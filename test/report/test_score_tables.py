"""The tables of a score: each cell leads back to its figure, and every row of the score is in a table."""

import pytest
from msgspec.structs import replace

from helpers.made_scores import dig, json_of, place_of, whole_score, with_target, without
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.records import Association
from sfr_loc_map.metrics.figures.row_part import RowPart
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.report.score_tables import page_tables, score_markdown, score_tables, summary_tables
from sfr_loc_map.tables.formats import to_csv
from sfr_loc_map.tables.model import Table


def table(score: Score, name: str) -> Table:
    return next(item for item in score_tables(score) if item.name == name)


def cells(shown: Table, row: int) -> dict[str, str]:
    return {column.title: cell.text for column, cell in zip(shown.columns, shown.rows[row], strict=True)}


def small() -> Score:
    """One condition with known figures, and three verdicts."""
    position = figure_row(
        *("position", "distance=5", "pose"),
        **{"n": 31, "mean": 0.0123456, "sigma": 0.002, "mean_plus_3sigma": 0.0183456, "low95": 0.015, "high95": 0.025},
    )
    heading = figure_row("heading", "distance=5", "pose", n=31, mean=-0.5, sigma=0.1, mean_plus_3sigma=0.8)
    attitude = figure_row("attitude", "distance=5", "pose", n=0)
    limited = Verdict(
        name="position_mean_plus_3sigma_m", subject=Subject.TRAJECTORY, condition="distance=5", part=RowPart("pose"),
        figure="position", statistic="mean_plus_3sigma", limit=0.02, value=0.0183456, low95=0.015, high95=0.025,
        margin=0.02 - 0.0183456, n=31, state=VerdictState.PASS, certain=False,
    )  # fmt: skip
    verdicts = (
        limited,
        Verdict(
            name="localisation_peak_bytes",
            figure="peak",
            part=RowPart("localisation"),
            statistic="value",
            limit=1048576,
            value=524288000,
            state=VerdictState.FAIL,
        ),
        Verdict(name="coverage_min", figure="coverage", limit=0.8, value=None, state=VerdictState.NOT_ENOUGH_DATA),
    )
    of_poses = Association(matched=31, estimate_poses=31, truth_poses=31)
    return Score(figures=(position, attitude, heading), verdicts=verdicts, association=of_poses)


def test_headline_and_verdicts_by_hand() -> None:
    shown = table(small(), "headline")
    assert cells(shown, 0) == {
        **{"figure": "position error over 5 m, pose", "unit": "mm", "mean": "12.35", "sigma": "2"},
        **{"mean + 3 sigma": "18.35", "95 % interval": "15 to 25", "n": "31"},
    }
    total = shown.rows[0][[column.title for column in shown.columns].index("mean + 3 sigma")]
    assert (total.value, total.key) == (0.0183456, "figures.0.mean_plus_3sigma")
    assert {cells(shown, 1)[name] for name in ("mean", "sigma", "mean + 3 sigma")} == {"not enough data"}
    judged = [[cell.text for cell in row] for row in table(small(), "verdicts").rows]
    assert judged[0] == [
        "pass", "position error over 5 m, mean + 3 sigma", "mm", "18.35", "≤ 20", "1.654", "15 to 25", "31", "no",
    ]  # fmt: skip
    assert judged[1][1:5] == ["peak memory, localisation", "MiB", "500", "≤ 1"]
    assert judged[2][1:5] == ["coverage", "%", "not enough data", "≥ 80"]


def test_the_summary_shows_a_completeness_without_any_value() -> None:
    unknown = figure_row("lost", n=3)
    score = Score(figures=(unknown, figure_row("missing", n=3)))
    (covered,) = (item for item in summary_tables(score) if item.name == "covered")
    assert [row[0].text for row in covered.rows] == ["lost", "missing"]
    known = Score(figures=(unknown, figure_row("missing", n=3, value=0.0), figure_row("degraded", n=3, value=0.5)))
    (covered,) = (item for item in summary_tables(known) if item.name == "covered")
    assert [row[0].text for row in covered.rows] == ["lost", "degraded"], "zeros are not shown"


def test_every_row_of_the_score_is_in_a_table_and_an_unknown_one_in_the_last() -> None:
    strange = Figure(subject=Subject.MAP, figure="roughness", unit="m", part=RowPart("all"), n=3, mean=0.25, value=7.0)
    stranger = Figure(
        subject=Subject.TRAJECTORY, figure="slip", unit="1", condition="turn=3", part=RowPart("left"), value=0.5
    )
    score = replace(whole_score(), figures=(*whole_score().figures, strange, stranger))
    shown = {
        cell.key.split(".")[1]
        for item in score_tables(score)
        for row in item.rows
        for cell in row
        if cell.key.startswith("figures.")
    }
    assert shown == {str(k) for k in range(len(score.figures))}
    assert "slip over 3 deg turned, left" in [row[0].text for row in table(score, "others").rows]
    exact = {line.split(",")[-2]: line.split(",")[-1] for line in to_csv(score_tables(score)).splitlines()}
    assert exact[f"{place_of(score, 'roughness', part='all')}.mean"] == "0.25"


def test_csv_has_a_line_for_each_undefined_number_of_a_row() -> None:
    """A program that reads the CSV distinguishes an undefined number from a key that does not exist."""
    rows = (
        figure_row("attitude", "distance=5", "pose", n=2, mean=0.1, sigma=0.1, mean_plus_3sigma=0.4),
        figure_row("attitude", "distance=10", "pose", n=1, mean=0.1),
        figure_row("missing", n=300),
        figure_row("restarts", value=2.0),
    )
    lines = to_csv(score_tables(Score(figures=rows))).splitlines()
    found = {line.split(",")[-2]: line.split(",")[-1] for line in lines[1:]}
    assert (found["figures.0.mean_plus_3sigma"], found["figures.1.mean_plus_3sigma"]) == ("0.4", "")
    assert (found["figures.2.value"], found["figures.3.value"]) == ("", "2.0")
    assert (found["figures.2.n"], found["figures.3.n"]) == ("300", "")


def test_a_verdict_in_csv_has_its_key_and_its_requirement() -> None:
    limits = parse_limits({"timing": {"localisation_max_s": {"limit": 1e9, "id": "R5"}}}, "limits")
    score = judged_by(whole_score(), limits)
    number = next(place for place, item in enumerate(score.verdicts) if item.id == "R5")
    lines = to_csv(score_tables(score)).splitlines()
    cells = {line.split(",")[-2]: line.split(",")[-1] for line in lines}
    assert cells[f"verdicts.{number}.id"] == "R5"
    assert cells[f"verdicts.{number}.verdict"] == score.verdicts[number].state.value


def test_every_cell_leads_back_to_its_figure_and_tables_keep_their_shape() -> None:
    score, plain = whole_score(), json_of(whole_score())
    found = [cell for item in score_tables(score) for row in item.rows for cell in row if cell.key]
    assert len(found) > 150
    for cell in found:
        if isinstance(cell.value, tuple):
            assert cell.value == tuple(dig(plain, f"{cell.key}.{end}") for end in ("low95", "high95"))
        elif cell.value is not None:
            assert cell.value == dig(plain, cell.key), cell
    for item in score_tables(score):
        assert {len(row) for row in item.rows} == {len(item.columns)}, item.name


@pytest.mark.clause("4.2.1", "4.2.2")
def test_fractions_are_in_per_cent_and_counts_and_ratios_have_no_unit() -> None:
    rows = (
        figure_row("coverage", n=400, value=0.5),
        figure_row("missing", n=300, value=0.01),
        figure_row("missing", part="count", n=300, value=3.0),
        figure_row("restarts", value=2.0),
        figure_row("nees", "distance=5", "pose", n=9, mean=6.0, low95=5.0, high95=7.0, value=6.0),
    )
    shown = {
        cells(item, at)["figure"]: (cells(item, at)["unit"], cells(item, at)["value"])
        for item in score_tables(Score(figures=rows))
        for at in range(len(item.rows))
    }
    assert shown["coverage"] == ("%", "50")
    assert (shown["missing"], shown["missing, count"]) == (("%", "1"), ("", "3"))
    assert shown["restarts of the live score"] == ("", "2")
    assert shown["normalised error squared (NEES) over 5 m, pose"] == ("", "6")


def test_the_terminal_shows_completeness_without_zeros_but_with_what_is_unknown() -> None:
    rows = (
        figure_row("missing", n=300, value=0.5),
        figure_row("lost", n=300, value=0.0),
        figure_row("degraded", n=300, value=None),
    )
    score = Score(figures=rows)
    (covered,) = (item for item in summary_tables(score) if item.name == "covered")
    assert [row[0].text for row in covered.rows] == ["missing", "degraded"]
    assert len(table(score, "covered").rows) == 3, "every other view has each row"


def test_a_page_shows_completeness_above_the_plots_without_zeros_and_below_completely() -> None:
    rows = (figure_row("missing", n=300, value=0.5), figure_row("lost", n=300, value=0.0))
    above, below = page_tables(Score(figures=rows))
    assert [[row[0].text for row in item.rows] for item in above if item.name == "covered"] == [["missing"]]
    assert [[row[0].text for row in item.rows] for item in below] == [["missing", "lost"]]
    names = [item.name for item in (*above, *below)]
    assert len({*names}) == len(names), "names are anchors of the page"


def test_a_table_has_no_statistic_that_is_limited_only_for_other_figures() -> None:
    point_error = figure_row("point_error", n=9, mean=0.1, sigma=0.1, mean_plus_3sigma=0.4, p95=0.2)
    position = figure_row("position", "distance=5", "pose", n=9, mean=0.1, sigma=0.1, mean_plus_3sigma=0.4, p95=0.2)
    limits = parse_limits({"map": {"point_error_p95_m": 0.25}}, "test")
    score = judged_by(replace(small(), figures=(position, point_error)), limits)
    assert "p95" in [column.title for column in table(score, "headline").columns]
    assert "p95" not in [column.title for column in table(score, "readings").columns]


def test_host_times_and_those_of_a_target_stand_apart_under_their_names() -> None:
    score = whole_score()
    other = with_target(score)
    assert {cell.text for row in table(other, "target-time").rows for cell in row[:1]} >= {"localisation time, target"}
    assert table(other, "target-memory").rows
    assert len(table(other, "time").rows) == len(table(score, "time").rows)
    for each, named in ((score, ""), (other, ", not on GR740")):
        note = table(each, "headline").note
        assert note.endswith(f" Host times were measured on the machine of the run{named}.")
        assert table(each, "time").note in note
    assert "GR740" not in score_markdown(score)
    assert "Clock" not in score_markdown(without(score, "timing"))
