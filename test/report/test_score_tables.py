"""The tables of a score: each cell leads back to its figure, and says it in the words of the glossary."""

from dataclasses import replace
from typing import Any

import pytest
from made_scores import dig, json_of, whole_score

from sfr_loc_map.metrics.config import Condition, VerdictState
from sfr_loc_map.metrics.score import Interval, IntervalStatistic, Score, TargetScore, TrajectoryScore, Verdict
from sfr_loc_map.report.score_tables import score_markdown, score_tables
from sfr_loc_map.report.tables import Row, Table

FIVE_METRES = Condition.parse("distance=5")


def table(score: Score, name: str) -> Table:
    return next(item for item in score_tables(score) if item.name == name)


def texts(row: Row) -> list[str]:
    return [cell.text for cell in row]


def small() -> Score:
    """One condition with known figures, and three verdicts."""

    def error(
        mean: float | None, sigma: float | None, total: float | None, ci95: Interval | None = None
    ) -> IntervalStatistic:
        return IntervalStatistic(mean=mean, sigma=sigma, mean_plus_3sigma=total, mean_plus_3sigma_ci95=ci95)

    def verdict(metric: str, limit: float, value: float | None, state: VerdictState) -> Verdict:
        margin = None if value is None else limit - value
        known: dict[str, Any] = {"ci95": None, "count": None, "certain": None, "margin": margin}
        return Verdict(metric=metric, limit=limit, value=value, state=state, **known)

    trajectory = whole_score().trajectory
    assert isinstance(trajectory, TrajectoryScore)
    first = replace(
        trajectory.first,
        count=31,
        condition=FIVE_METRES,
        position_m=error(0.0123456, 0.002, 0.0183456, (0.015, 0.025)),
        attitude_deg=error(None, None, None),
        heading_deg=error(-0.5, 0.1, 0.8),
    )
    position = verdict("position_mean_plus_3sigma_m", 0.02, 0.0183456, VerdictState.PASS)
    verdicts = (
        replace(position, condition=FIVE_METRES, count=31, ci95=(0.015, 0.025), certain=False),
        verdict("localisation_peak_bytes", 1048576, 524288000, VerdictState.FAIL),
        verdict("coverage_min", 0.8, None, VerdictState.NOT_ENOUGH_DATA),
    )
    return Score(trajectory=replace(trajectory, first=first, several=()), verdicts=verdicts)


def test_headline_and_verdicts_by_hand() -> None:
    rows = table(small(), "headline").rows
    assert texts(rows[0]) == [
        "position error over 5 m",
        "mm",
        "12.35",
        "2",
        "mean + 3 sigma",
        "18.35",
        "15 to 25",
        "31",
    ]
    assert (rows[0][5].value, rows[0][5].key) == (0.0183456, "trajectory.position_m.mean_plus_3sigma")
    assert texts(rows[1])[2:6] == ["not enough data"] * 2 + ["mean + 3 sigma", "not enough data"]
    judged = [texts(row) for row in table(small(), "verdicts").rows]
    assert judged[0] == [
        "pass", "position mean + 3 sigma, over 5 m", "mm", "18.35", "≤ 20", "1.654", "15 to 25", "31", "no",
    ]  # fmt: skip
    assert judged[1][1:5] == ["localisation peak", "MiB", "500", "≤ 1"]
    assert judged[2][1:5] == ["map coverage", "share", "not enough data", "≥ 0.8"]


def test_every_cell_leads_back_to_its_figure_and_tables_keep_their_shape() -> None:
    score, plain = whole_score(), json_of(whole_score())
    cells = [cell for item in score_tables(score) for row in item.rows for cell in row if cell.key]
    assert len(cells) > 150
    for cell in cells:
        found = dig(plain, cell.key)
        assert cell.value == (tuple(found) if isinstance(found, list) else found), cell
    for item in score_tables(score):
        assert {len(row) for row in item.rows} == {len(item.columns)}, item.name


@pytest.mark.clause("4.2.1", "4.2.2")
def test_host_times_and_those_of_a_target_stand_apart_under_their_names() -> None:
    score = whole_score()
    assert score.timing is not None
    assert score.memory is not None
    other = replace(score, target=TargetScore(name="GR740", timing=score.timing, memory=score.memory))
    shown, memory = table(other, "target-time"), table(other, "target-memory")
    assert (shown.title, shown.rows[0][2].key) == ("Time per call on GR740", "target.timing.localisation_s.p50")
    assert memory.rows[0][1].key == "target.memory.localisation_peak_bytes"
    for each, named in ((score, ""), (other, ", not of GR740")):
        note = table(each, "headline").note
        assert note.endswith(f" Host times are of the machine the run was made on{named}.")
        assert table(each, "time").note in note
    assert "GR740" not in score_markdown(score)
    assert "Clock" not in score_markdown(replace(score, timing=None))
