"""A figure or a statistic that is added in one place is in every view: tables, files, limits, suites, topics."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

from helpers.made_scores import drive, json_of
from helpers.made_suites import JOB
from sfr_loc_map.metrics import catalogue, trajectory_score
from sfr_loc_map.metrics.catalogue import OF_ERRORS, TOTAL, FigureKind, Subject
from sfr_loc_map.metrics.comparison import compare_scores
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.judging import judge, limits
from sfr_loc_map.metrics.score import Details, Score, figure_row
from sfr_loc_map.nodes.monitor_node import figure_topics, score_statuses
from sfr_loc_map.report.comparison import comparison_tables, methods_tables
from sfr_loc_map.report.page import render_page
from sfr_loc_map.report.score_tables import score_markdown, score_tables, summary_tables, undefined_of
from sfr_loc_map.report.tables import Table, to_csv, to_rich
from sfr_loc_map.report.test_report import junit, render_test_report
from sfr_loc_map.suite.pages.tables import result_table
from sfr_loc_map.suite.statistics.figures import figures_of
from sfr_loc_map.suite.statistics.summary import ScoredJob, pool

SLIP = FigureKind(
    "slip", Subject.TRAJECTORY, "4.2.3.1", "m", "slip error", shown=OF_ERRORS, compared=(TOTAL,), topic="slip"
)
SLIP_ERROR = trajectory_score.ErrorFigure("slip", lambda pieces: np.abs(pieces.errors.position_m[:, 0]))
MakeScore = Callable[..., Score]


def made_score(seed: int = 0, **entry: Any) -> Score:
    """A score of one condition with a limit on it; the estimate depends on the seed."""
    estimates, truth = drive(300)
    rng = np.random.default_rng(seed)
    estimates.trajectory.positions[:] += np.cumsum(rng.normal(0.0, 1e-3, (300, 3)), axis=0)
    made = trajectory_score.score_trajectory(estimates, truth, TrajectoryScoreConfig(conditions=("distance=5",)))
    score = Score(
        figures=made.figures, association=made.association, truth=made.truth, details=Details(trajectory=made.details)
    )
    return judge.judged(score, limits.parse_limits({"trajectory": [{"condition": "distance=5", **entry}]}, "test"))


def on_the_terminal(score: Score) -> str:
    """What `sfr score` prints."""
    console = Console(file=io.StringIO(), width=250)
    for table in summary_tables(score):
        console.print(to_rich(table))
    return console.file.getvalue()  # type: ignore[attr-defined]


def table_named(tables: list[Table], name: str) -> Table:
    return next(table for table in tables if table.name == name)


def titles(table: Table) -> list[str]:
    return [column.title for column in table.columns]


def test_a_statistic_of_a_figure_is_in_every_view(monkeypatch: pytest.MonkeyPatch) -> None:
    """The 99 % quantile of the position error is shown and compared as soon as its line in the catalogue names it."""
    kind = catalogue.KINDS["position"]
    without = made_score(position_mean_plus_3sigma_m=1.0)
    assert "p99" not in titles(table_named(summary_tables(without), "headline"))
    assert "metrics/position/p99" not in figure_topics()

    added = kind._replace(shown=(*kind.shown, "p99"), compared=(*kind.compared, "p99"))
    monkeypatch.setitem(catalogue.KINDS, "position", added)

    scores = [made_score(seed, position_p99_m=1e-9) for seed in (0, 1)]
    score = scores[0]
    row = score.judged_row("position")
    assert row is not None
    place = f"figures.{score.figures.index(row)}.p99"
    shown = f"{1e3 * (row.p99 or 0.0):.4g}"
    headline = table_named(summary_tables(score), "headline")
    column = titles(headline).index("p99")
    assert headline.rows[0][column].text == shown
    assert headline.rows[0][column].key == place
    assert "p99" in titles(table_named(score_tables(score), "readings"))
    for text in (on_the_terminal(score), render_page(score, figures=False), score_markdown(score)):
        assert "p99" in text
        assert shown in text
    assert f"{place},{row.p99!r}" in to_csv(score_tables(score))
    assert f'name="value" value="{row.p99}"' in junit({"score": score})
    assert f'data-key="{place}"' in render_test_report([score])
    compared = comparison_tables(compare_scores(scores, ["a", "b"]))
    assert any(cells[0].text.startswith("position") and "p99" in cells[0].text for cells in compared[1].rows)
    methods = methods_tables(scores, ["a", "b"])[0]
    assert row.p99 in [cell.value for cells in methods.rows for cell in cells]
    drives = result_table("drives", "", [ScoredJob(JOB, score)], set(), Subject.TRAJECTORY)
    assert drives.rows[0][titles(drives).index("position, p99")].value == row.p99
    history = {item.name: value for item, value in figures_of(score).items()}
    assert history["position p99 over 5 m, m"] == row.p99
    figure, statistic = figure_topics()["metrics/position/p99"]
    assert score.number(figure, statistic) == row.p99
    status = next(item for item in score_statuses(score) if item.name.endswith("distance=5/pose/position"))
    assert float(next(item.value for item in status.values if item.key == "p99")) == pytest.approx(row.p99)


@pytest.fixture
def with_slip(monkeypatch: pytest.MonkeyPatch) -> None:
    """A figure that the catalogue has since a moment ago, with the function that computes its errors."""
    monkeypatch.setitem(catalogue.KINDS, SLIP.name, SLIP)
    monkeypatch.setattr(trajectory_score, "ERRORS", [*trajectory_score.ERRORS, SLIP_ERROR])
    names = limits.PLACES[limits.LimitPart.TRAJECTORY]
    for name, limited in limits.names_of([SLIP]).items():
        monkeypatch.setitem(names, name, limited)


@pytest.mark.usefixtures("with_slip")
def test_a_figure_is_in_every_view() -> None:
    scores = [made_score(seed, slip_p99_m=1e-9) for seed in (0, 1)]
    score = scores[0]
    row = score.figure("slip")
    assert row is not None
    assert row.p99 is not None
    place = f"figures.{score.figures.index(row)}.p99"
    assert json_of(score)["figures"][score.figures.index(row)]["p99"] == row.p99
    (verdict,) = score.verdicts
    assert (verdict.name, verdict.value, verdict.state) == ("slip_p99_m", row.p99, "fail")
    assert set(verdict.by_reading) == {"pose", "displacement", "position"}
    headline = table_named(summary_tables(score), "headline")
    assert "slip error over 5 m, pose" in [cells[0].text for cells in headline.rows]
    texts = (on_the_terminal(score), render_page(score, figures=False), score_markdown(score))
    for text in (*texts, to_csv(score_tables(score)), render_test_report([score])):
        assert "slip error over 5 m" in text
    assert place in to_csv(score_tables(score))
    assert "slip error over 5 m, p99" in junit({"score": score})
    assert "slip error over 5 m, p99" in render_test_report([score])
    assert "slip" in [pair.figure for pair in compare_scores(scores, ["a", "b"]).pairs]
    methods = methods_tables([score, replace(score, verdicts=())], ["a", "b"])[0]
    assert "slip error over 5 m" in titles(methods)
    assert len(score.to_pandas().query("figure == 'slip'")) > 3
    assert "metrics/slip/mean_plus_3sigma" in figure_topics()
    assert any(item.name.endswith("distance=5/pose/slip") for item in score_statuses(score))


@pytest.mark.usefixtures("with_slip")
def test_a_figure_is_in_the_tables_of_suites_and_in_the_history(tmp_path: Path) -> None:
    score = made_score(slip_p99_m=1e-9)
    row = score.judged_row("slip")
    assert row is not None
    assert "slip over 5 m, m" in [item.name for item in figures_of(score)]
    pooled = {item.figure: item for item in pool([("a", score), ("b", score)], "distance=5")}
    assert pooled["slip"].n == 2 * (row.n or 0)
    drives = result_table("drives", "", [ScoredJob(JOB, score)], set(), Subject.TRAJECTORY)
    assert drives.rows[0][titles(drives).index("slip, mean + 3 sigma")].value == row.mean_plus_3sigma


def test_a_row_without_its_number_is_said_in_one_word_by_tables_and_diagnostics() -> None:
    unknown = figure_row("above_idle", part="localisation")
    few = figure_row("position", "distance=5", "pose", n=1, mean=0.1)
    known = figure_row("missing", value=0.0)
    for row, text in ((unknown, "unknown"), (few, "not enough data"), (known, "")):
        (status,) = score_statuses(Score(figures=(row,)))
        assert status.message == text
        assert row.is_defined == (not text)
        if text:
            assert undefined_of(row, "value" if row.is_one_number else "sigma") == text
