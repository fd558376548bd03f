"""The bars of an error budget: names, order by size, and intervals."""

from __future__ import annotations

from sfr_loc_map.suite.pages.page import budget_plot
from sfr_loc_map.suite.statistics.budget import Budget, BudgetFigure, BudgetRow


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
