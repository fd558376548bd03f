"""Several methods on one page: a row each, paired differences, figures together, cost against accuracy."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from helpers.made_scores import HOSTILE, whole_score, without
from sfr_loc_map.cli.main import app
from sfr_loc_map.metrics.completeness.expected_items import answers_completeness
from sfr_loc_map.metrics.figures.records import (
    AnswerCounts,
    ExternalScore,
    FindingKind,
    FindingRecord,
    MethodKind,
    MethodRecord,
)
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.formulas import Statistics
from sfr_loc_map.metrics.judging.judge import with_verdicts
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.report.methods_page import methods_plots, methods_tables
from sfr_loc_map.report.plots import plain

LATENCY = Statistics(n=9, mean=0.05, sigma=0.01, mean_plus_3sigma=0.08, p50=0.05, p95=0.07, max=0.08)


@pytest.fixture(scope="module")
def scores() -> list[Score]:
    sfr, theirs = (
        MethodRecord(name=name, version="1.2", kind=kind)
        for name, kind in (("sfr", MethodKind.BUILT_IN), ("their node", MethodKind.EXTERNAL))
    )
    node = ExternalScore(
        task="localisation", topic="odom", frames="a -> b", answers=AnswerCounts(pairs=9, answered=9), latency_s=LATENCY
    )
    of_answers = tuple(answers_completeness(node))
    keys = [(row.figure, row.part) for row in of_answers]
    other = without(whole_score(), "timing", "memory")
    others = tuple(row for row in other.figures if (row.figure, row.part) not in keys)
    other = replace(other, figures=(*others, *of_answers), method=theirs, external=node)
    call = (
        figure_row("mapping_call", n=1, mean=2.5, rmse=2.5, max=2.5, p50=2.5, p95=2.5),
        figure_row("mapping_call", part="first call", value=2.5),
        figure_row("peak", part="mapping_call", value=7),
    )
    own = replace(whole_score(), method=sfr)
    return [replace(own, figures=(*own.figures, *call)), with_verdicts(other)]


def test_each_method_has_a_row_and_a_latency_is_no_time_per_call(scores: list[Score]) -> None:
    table = methods_tables(scores, ["sfr", "their node"])[0]
    cells = {column.title: [row[k].text for row in table.rows] for k, column in enumerate(table.columns)}
    assert cells["method"] == ["sfr", "their node"]
    assert cells["kind"] == ["built-in", "external"]
    assert cells["localisation time p50"][1] == "latency 50"
    assert "latency" not in cells["localisation time p50"][0]
    assert cells["mapping time p50"] == ["2500", "-"], "the call of the document, not its stage for one pair"
    assert cells["localisation memory"][1] == "-"
    total = scores[0].number("position", "mean_plus_3sigma")
    assert cells["position error over 5 m"][0].startswith(f"{1e3 * total:.4g}")


def test_times_and_memory_of_a_task_are_only_compared_with_those_of_the_same_task(scores: list[Score]) -> None:
    """A mapping call was the worst localisation call, and a method with both tasks was not compared at all."""
    both = scores[0]
    slower = replace(
        both,
        figures=tuple(
            replace(row, p50=2.0 * row.p50) if row.figure == "localisation" and row.p50 is not None else row
            for row in both.figures
        ),
    )
    of_mapping = replace(
        both, figures=tuple(row for row in both.figures if "localisation" not in (row.figure, str(row.part)))
    )
    named = {"both": both, "slower": slower, "mapping": of_mapping}
    table = methods_tables(list(named.values()), list(named))[0]
    columns = {column.title: k for k, column in enumerate(table.columns)}
    marks = {row[0].text: row[columns["localisation time p50"]].mark for row in table.rows}
    assert marks == {"both": "best", "slower": "worst", "mapping": ""}
    assert not any(row[columns["mapping time p50"]].mark for row in table.rows)


def test_errors_are_compared_over_a_condition_that_all_scores_have(scores: list[Score]) -> None:
    """A score whose first condition is another one was shown below the condition of the last score."""
    longer = tuple(
        replace(row, condition="distance=10", mean_plus_3sigma=9.0)
        for row in scores[0].rows("position", condition="distance=5")
    )
    other = replace(scores[0], figures=(*longer, *scores[0].figures))
    table = methods_tables([scores[0], other], ["sfr", "other"])[0]
    (column,) = (k for k, each in enumerate(table.columns) if each.title.startswith("position error over"))
    assert table.columns[column].title == "position error over 5 m"
    assert len({row[column].text for row in table.rows}) == 1
    alone = replace(scores[0], figures=longer)
    table = methods_tables([scores[0], alone], ["sfr", "alone"])[0]
    assert [row[column].text for row in table.rows][1] == "-"


@pytest.mark.parametrize("flaw", ["incomplete", "contradiction", "findings"])
def test_a_method_without_all_results_is_not_the_best(scores: list[Score], flaw: str) -> None:
    """A method that gave up early has small errors and short times."""
    rows = tuple(
        replace(row, mean=0.1 * row.mean, mean_plus_3sigma=0.1 * row.mean_plus_3sigma)
        if row.mean is not None and row.mean_plus_3sigma is not None
        else row
        for row in scores[0].figures
    )
    crash = FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=1, text="why")
    early = replace(scores[0], figures=rows, **{flaw: (crash,) if flaw == "findings" else "why"})
    table = methods_tables([early, scores[0]], ["early", "sfr"])[0]
    assert [row[0].text for row in table.rows] == ["sfr", "early"]
    assert not any(cell.mark for row in table.rows for cell in row)
    assert (
        methods_tables([replace(scores[0], figures=rows), scores[0]], ["better", "sfr"])[0].rows[0][0].text == "better"
    )


def test_figures_hold_all_methods_and_no_sign_that_plotly_reads(scores: list[Score]) -> None:
    plots = {plot.name: plot for _, group in methods_plots(scores, ["sfr", HOSTILE]) for plot in group}
    assert set(plots) >= {"paths", "errors", "growth", "cost-localisation", "cost-mapping", "map-ranges"}
    assert [trace["name"] for trace in plots["paths"].data] == ["truth", "sfr", plain(HOSTILE[:60])]
    latency = plots["cost-localisation"].data[1]
    assert (latency["name"].endswith("(latency)"), latency["x"]) == (True, [50.0])
    assert latency["marker"]["symbol"].endswith("-open")
    assert not set("<>") & set(plain(HOSTILE))
    assert methods_plots([Score()] * 2, ["a", "b"]) == []


def test_the_command_names_methods_and_writes_page_and_json(scores: list[Score], tmp_path: Path) -> None:
    paths = [str(tmp_path / f"{number}.json") for number in range(2)]
    for path, score in zip(paths, scores, strict=True):
        Path(path).write_text(to_json(score))
    page, found = tmp_path / "page.html", tmp_path / "compared.json"
    result = CliRunner().invoke(app, ["report", *paths, "-o", str(page), "--json", str(found)])
    assert result.exit_code == 1, "one of the scores misses a limit"
    content = json.loads(found.read_text())
    assert content["names"] == ["sfr", "their node"]
    assert [method["kind"] for method in content["methods"]] == ["built-in", "external"]
    for words in ("their node", "Provenance of the scores", "Cost against accuracy", "sfr_loc_map"):
        assert words in page.read_text()
