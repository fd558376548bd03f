"""A figure or a statistic that is added in one place is in every view: tables, files, limits, suites, topics."""

from __future__ import annotations

import dataclasses
import io
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

import sfr_loc_map
from helpers.made_scores import drive, json_of
from helpers.made_suites import JOB, scored_job
from sfr_loc_map.metrics.comparison import compare_scores
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures import catalogue
from sfr_loc_map.metrics.figures.catalogue import OF_ERRORS, TOTAL, FigureKind
from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.figures.subjects import LimitSection, Subject
from sfr_loc_map.metrics.judging import judge, limits_file
from sfr_loc_map.metrics.score import limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.file_check import checked_score
from sfr_loc_map.metrics.stored.score_json import from_dict
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.nodes.monitor.score_publisher import figure_topics, score_statuses
from sfr_loc_map.report.comparison import comparison_tables
from sfr_loc_map.report.junit import junit
from sfr_loc_map.report.methods_page import methods_tables
from sfr_loc_map.report.page import render_page, score_plots
from sfr_loc_map.report.printed_plot import printed_plots
from sfr_loc_map.report.score_tables import score_markdown, score_tables, summary_tables, undefined_of
from sfr_loc_map.report.test_report import render_test_report
from sfr_loc_map.suite.pages.tables import result_table
from sfr_loc_map.suite.search.specification import CHOICES
from sfr_loc_map.suite.statistics.figures import figures_of
from sfr_loc_map.suite.statistics.pooling import pool
from sfr_loc_map.suite.statistics.scored_job import ScoredJob
from sfr_loc_map.tables.formats import to_csv, to_rich
from sfr_loc_map.tables.model import Table

SLIP = FigureKind(
    "slip",
    Subject.TRAJECTORY,
    "slip error",
    clause="4.2.3.1",
    unit="m",
    shown=OF_ERRORS,
    compared=(TOTAL,),
    tested=(TOTAL,),
    topic="slip",
    compute_errors=lambda sub_trajectories: np.abs(sub_trajectories.errors.position_m[:, 0]),
)
MakeScore = Callable[..., Score]


def made_score(seed: int = 0, **entry: Any) -> Score:
    """A score of one condition with a limit on it; the estimate depends on the seed."""
    estimates, truth = drive(300)
    rng = np.random.default_rng(seed)
    estimates.trajectory.positions[:] += np.cumsum(rng.normal(0.0, 1e-3, (300, 3)), axis=0)
    made = score_trajectory(estimates, truth, TrajectoryScoreConfig(conditions=("distance=5",)))
    score = Score(
        figures=made.figures, association=made.association, truth=made.truth, details=Details(trajectory=made.details)
    )
    return judge.judged_by(
        score, limits_file.parse_limits({"trajectory": [{"condition": "distance=5", **entry}]}, "test")
    )


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
    added = dataclasses.replace(
        kind, shown=(*kind.shown, "p99"), compared=(*kind.compared, "p99"), tested=(*kind.tested, "p99")
    )
    monkeypatch.setitem(catalogue.KINDS, "position", added)
    check_every_view("p99")


def test_a_new_statistic_is_in_every_view(tmp_path: Path) -> None:
    """A 90 % quantile, whose column is a line of `metrics.formulas`, in a copy of the package."""
    package = Path(sfr_loc_map.__file__).parent
    copy = tmp_path / "sfr_loc_map"
    folders = (Path(), Path("metrics"), Path("metrics", "figures"))
    copied = ("metrics", "figures", "formulas.py", "catalogue.py")
    for folder in folders:
        (copy / folder).mkdir(parents=True)
        for path in (package / folder).iterdir():
            if path.name not in copied:
                (copy / folder / path.name).symlink_to(path)
    changes = {
        "formulas.py": (
            ("    p95: float | None = None", "    p90: float | None = None\n    p95: float | None = None"),
        ),
        "figures/catalogue.py": (
            ('OF_ERRORS = ("mean", "sigma", TOTAL)', 'OF_ERRORS = ("mean", "sigma", "p90", TOTAL)'),
            ("COMPARED = (TOTAL,)", 'COMPARED = (TOTAL, "p90")'),
            ("TESTED = (TOTAL,)", 'TESTED = (TOTAL, "p90")'),
        ),
    }
    for name, replaced in changes.items():
        text = (package / "metrics" / name).read_text()
        for old, new in replaced:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (copy / "metrics" / name).write_text(text)
    places = [tmp_path, Path(__file__).parent, Path(__file__).parents[1]]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*map(str, places), os.environ.get("PYTHONPATH", "")])}
    script = "import test_one_place, sfr_loc_map; test_one_place.check_every_view('p90'); print(sfr_loc_map.__file__)"
    done = subprocess.run([sys.executable, "-c", script], env=environment, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(copy / "__init__.py")


def check_every_view(statistic: str) -> None:
    """Check that a statistic of the position error, which the catalogue names, is in every view."""
    scores = [made_score(seed, **{f"position_{statistic}_m": 1e-9}) for seed in (0, 1)]
    score = scores[0]
    row = score.judged_row("position")
    assert row is not None
    number = row.statistic(statistic)
    assert number is not None
    place = f"figures.{score.figures.index(row)}.{statistic}"
    shown = f"{1e3 * number:.4g}"
    headline = table_named(summary_tables(score), "headline")
    column = titles(headline).index(statistic)
    assert headline.rows[0][column].text == shown
    assert headline.rows[0][column].key == place
    assert statistic in titles(table_named(score_tables(score), "readings"))
    for text in (on_the_terminal(score), render_page(score, plots=False), score_markdown(score)):
        assert statistic in text
        assert shown in text
    assert f"{place},{number!r}" in to_csv(score_tables(score))
    assert f'name="value" value="{number}"' in junit({"score": score})
    assert f'data-key="{place}"' in render_test_report([score])
    drawn = next(plot for _, plots in score_plots(score) for plot in plots if plot.name == "position")
    level = next(trace["y"][0] for trace in drawn.data if trace["name"] == f"{statistic}, 5 m")
    assert level == pytest.approx(1e3 * number, rel=1e-5)
    printed = printed_plots(score)[0]
    assert f"{statistic} {shown} mm" in [*(line.text for line in printed.levels), printed.beyond]
    compared = comparison_tables(compare_scores(scores, ["a", "b"]))
    assert any(cells[0].text.startswith("position") and statistic in cells[0].text for cells in compared[1].rows)
    methods = methods_tables(scores, ["a", "b"])[0]
    assert number in [cell.value for cells in methods.rows for cell in cells]
    drives = result_table("drives", "", [ScoredJob(JOB, score)], set(), Subject.TRAJECTORY)
    assert drives.rows[0][titles(drives).index(f"position, {statistic}")].value == number
    history = {item.name: value for item, value in figures_of(score).items()}
    assert history[f"position {statistic} over 5 m, m"] == number
    assert figure_topics()[f"metrics/position/{statistic}"] == ("position", statistic)
    status = next(item for item in score_statuses(score) if item.name.endswith("distance=5/pose/position"))
    assert float(next(item.value for item in status.values if item.key == statistic)) == pytest.approx(number)
    assert score.on_limits[0].value == number
    assert statistic in CHOICES
    stored = json_of(score)
    assert stored["figures"][score.figures.index(row)][statistic] == number
    assert from_dict(stored) == score
    without = {**stored, "verdicts": [], "verdict": None, "rules": None}
    del without["content_sha256"]
    without["figures"] = [{name: each[name] for name in each if name != statistic} for each in stored["figures"]]
    assert from_dict(without).number("position", statistic) is None, "a score that is older than the statistic is read"


@pytest.fixture
def with_slip(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """A figure that the catalogue has since a moment ago, of scalars or of vectors."""
    kind = SLIP
    if getattr(request, "param", "scalars") == "vectors":
        kind = dataclasses.replace(
            SLIP, compute_errors=lambda sub_trajectories: sub_trajectories.errors.position_m[:, :2]
        )
    monkeypatch.setitem(catalogue.KINDS, SLIP.name, kind)
    names = limits.LIMITED_NUMBERS[LimitSection.TRAJECTORY]
    for name, limited in limits.names_of([kind]).items():
        monkeypatch.setitem(names, name, limited)


@pytest.mark.usefixtures("with_slip")
@pytest.mark.parametrize("with_slip", ["scalars", "vectors"], indirect=True)
def test_a_figure_is_in_every_view() -> None:
    scores = [made_score(seed, slip_p99_m=1e-9) for seed in (0, 1)]
    score = scores[0]
    assert checked_score(score) == score
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
    texts = (on_the_terminal(score), render_page(score, plots=False), score_markdown(score))
    for text in (*texts, to_csv(score_tables(score)), render_test_report([score])):
        assert "slip error over 5 m" in text
    assert place in to_csv(score_tables(score))
    assert "slip error over 5 m, p99" in junit({"score": score})
    assert "slip error over 5 m, p99" in render_test_report([score])
    assert "slip" in [pair.figure for pair in compare_scores(scores, ["a", "b"]).pairs]
    methods = methods_tables([score, replace(score, verdicts=())], ["a", "b"])[0]
    assert "slip error over 5 m" in titles(methods)
    assert len(sfr_loc_map.Score.of(score).to_pandas().query("figure == 'slip'")) > 3
    assert "metrics/slip/mean_plus_3sigma" in figure_topics()
    assert any(item.name.endswith("distance=5/pose/slip") for item in score_statuses(score))


@pytest.mark.usefixtures("with_slip")
def test_a_figure_is_in_the_tables_of_suites_and_in_the_history(tmp_path: Path) -> None:
    score = made_score(slip_p99_m=1e-9)
    row = score.judged_row("slip")
    assert row is not None
    assert "slip over 5 m, m" in [item.name for item in figures_of(score)]
    pooled = {item.figure: item for item in pool([scored_job("a", score), scored_job("b", score)], "distance=5")}
    assert pooled["slip"].n == 2 * (row.n or 0)
    drives = result_table("drives", "", [ScoredJob(JOB, score)], set(), Subject.TRAJECTORY)
    assert drives.rows[0][titles(drives).index("slip, mean + 3 sigma")].value == row.mean_plus_3sigma


def test_a_row_without_its_number_is_said_in_one_word_by_tables_and_diagnostics() -> None:
    unknown = figure_row("above_idle", part="localisation")
    few = figure_row("position", "distance=5", "pose", n=1, mean=0.1)
    known = figure_row("missing", value=0.0)
    no_height = figure_row("nmad")
    for row, text in ((unknown, "unknown"), (no_height, "unknown"), (few, "not enough data"), (known, "")):
        (status,) = score_statuses(Score(figures=(row,)))
        assert status.message == text
        assert row.is_defined == (not text)
        if text:
            assert undefined_of(row, "value" if row.is_one_number else "sigma") == text
