"""A figure is added in one place, and is then in every view: tables, files, limits, comparisons, suites, histories."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from helpers.made_scores import drive, json_of
from sfr_loc_map.metrics import catalogue, limits, trajectory_score
from sfr_loc_map.metrics.catalogue import FigureKind, Subject
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.report.comparison import methods_tables
from sfr_loc_map.report.page import render_page
from sfr_loc_map.report.score_tables import score_markdown, score_tables, summary_tables
from sfr_loc_map.report.tables import to_csv
from sfr_loc_map.report.test_report import junit, render_test_report

KIND = FigureKind("slip", Subject.TRAJECTORY, "4.2.3.1", "m", "slip error", is_headline=True, is_compared=True)
FIGURE = trajectory_score.ErrorFigure("slip", lambda pieces: np.abs(pieces.errors.position_m[:, 0]))


@pytest.fixture
def score(monkeypatch: pytest.MonkeyPatch) -> Score:
    """A score with a figure that the catalogue has since a moment ago."""
    monkeypatch.setitem(catalogue.KINDS, KIND.name, KIND)
    monkeypatch.setattr(trajectory_score, "ERRORS", [*trajectory_score.ERRORS, FIGURE])
    names = limits.PLACES[limits.LimitPart.TRAJECTORY]
    for name, limited in limits.names_of([KIND]).items():
        monkeypatch.setitem(names, name, limited)
    made = trajectory_score.score_trajectory(*drive(300), TrajectoryScoreConfig(conditions=("distance=5",)))
    score = Score(figures=made.figures, association=made.association, truth=made.truth)
    entry: dict[str, Any] = {"condition": "distance=5", "slip_p99_m": 1e-9}
    return limits.judged(score, limits.parse_limits({"trajectory": [entry]}, "test"))


def test_a_figure_is_in_every_view(score: Score, tmp_path: Path) -> None:
    row = score.figure("slip")
    assert row.p99 is not None
    place = f"figures.{score.figures.index(row)}.p99"
    assert json_of(score)["figures"][score.figures.index(row)]["p99"] == row.p99
    (verdict,) = score.verdicts
    assert (verdict.name, verdict.value, verdict.state) == ("slip_p99_m", row.p99, "fail")
    assert set(verdict.by_reading) == {"pose", "displacement", "position"}
    headline = next(table for table in summary_tables(score) if table.name == "headline")
    assert "slip error over 5 m, pose" in [cells[0].text for cells in headline.rows]
    for text in (render_page(score, figures=False), score_markdown(score), to_csv(score_tables(score))):
        assert "slip error over 5 m" in text
    assert place in to_csv(score_tables(score))
    assert "slip p99 over 5 m" in junit({"score": score})
    assert "slip p99 over 5 m" in render_test_report([score])
    methods = methods_tables([score, replace(score, verdicts=())], ["a", "b"])[0]
    assert "slip error over 5 m" in [column.title for column in methods.columns]
    assert len(score.to_pandas().query("figure == 'slip'")) > 3


def test_a_figure_is_in_the_comparison_of_suites_and_in_the_history(score: Score) -> None:
    from sfr_loc_map.suite.figures import figures_of
    from sfr_loc_map.suite.summary import pool

    assert "slip over 5 m, m" in [item.name for item in figures_of(score)]
    pooled = {row.figure: row for row in pool([("a", score), ("b", score)], "distance=5")}
    assert pooled["slip"].n == 2 * score.figure("slip").n
