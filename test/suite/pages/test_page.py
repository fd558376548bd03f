"""The page of a suite: bars of an error budget, the order of results, and the results with a page of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from helpers.made_suites import JOB, recording
from sfr_loc_map.metrics.figures.records import Association
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.suite.pages.page import budget_plot
from sfr_loc_map.suite.pages.tables import MAX_PAGES, linked, worst_first, worst_maps_first
from sfr_loc_map.suite.statistics.budget import Budget, BudgetFigure, BudgetRow
from sfr_loc_map.suite.statistics.scored_job import ScoredJob
from sfr_loc_map.suite.statistics.summary import Summary


def row(source: str, alone: float, half: float) -> BudgetRow:
    estimate = BudgetFigure(alone, (alone - half, alone + half))
    return BudgetRow(
        source=source, alone=estimate, removed=estimate, interaction=BudgetFigure(0.0), mean_m=None, sigma_m=None
    )


def test_bars_have_the_names_of_their_sources_as_plain_text() -> None:
    rows = (row("stamps", 0.1, 0.05), row("<a href='x'>noise</a>", 0.6, 0.2))
    budget = Budget(
        configuration="default",
        condition="distance=5",
        drives=6,
        left_out=0,
        rms_m=0.01,
        rows=rows,
        rest=BudgetFigure(0.3),
        total=BudgetFigure(1.0),
    )
    alone, removed = budget_plot(budget).data
    assert alone["x"] == removed["x"] == ["&lt;a href='x'&gt;noise&lt;/a&gt;", "stamps"]
    assert alone["y"] == [60.0, 10.0]
    assert [round(value, 9) for value in alone["error_y"]["array"]] == [20.0, 5.0]


def summary_of(drive_errors: list[float | None], map_errors: list[float | None]) -> Summary:
    """Return a summary with a drive for each position error and a map for each point error, m; None: no figure."""
    found = []
    for number, error in enumerate(drive_errors):
        rows = () if error is None else (figure_row("position", "distance=5", "pose", n=9, mean_plus_3sigma=error),)
        association = Association(matched=9, estimate_poses=9, truth_poses=9)
        found.append((f"drive{number}", Score(figures=rows, association=association)))
    for number, error in enumerate(map_errors):
        rows = (figure_row("coverage", value=0.5),)
        if error is not None:
            rows += (figure_row("point_error", n=9, mean_plus_3sigma=error, p50=error, p95=error),)
        found.append((f"map{number}", Score(figures=rows)))
    results = tuple(ScoredJob(replace(JOB, source=recording(name, sha256=name)), score) for name, score in found)
    return Summary(groups=(), results=results, failures=(), refusals=(), code="")


def names_of(results: Sequence[ScoredJob]) -> list[str]:
    return [result.job.source.name for result in results]


def test_results_without_the_error_are_the_worst() -> None:
    summary = summary_of([0.1, None, 0.3], [0.2, None])
    assert names_of(worst_first(summary)) == ["drive1", "drive2", "drive0"]
    assert names_of(worst_maps_first(summary.results)) == ["map1", "map0"]


@pytest.mark.parametrize(("drives", "maps"), [(MAX_PAGES + 9, 3), (3, MAX_PAGES + 9), (MAX_PAGES, MAX_PAGES), (2, 2)])
def test_the_worst_maps_have_pages_whatever_the_number_of_drives(drives: int, maps: int) -> None:
    names = names_of(linked(summary_of([0.1] * drives, [0.1] * (maps - 1) + [None])))
    assert "map" + str(maps - 1) in names
    assert len(set(names)) == len(names) == min(drives + maps, MAX_PAGES)
    assert sum(name.startswith("drive") for name in names) >= min(drives, MAX_PAGES // 2)
