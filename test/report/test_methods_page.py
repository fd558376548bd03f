"""Several methods on one page: a row each, paired differences, figures together, cost against accuracy."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from made_scores import HOSTILE, whole_score
from typer.testing import CliRunner

from sfr_loc_map.cli.main import app
from sfr_loc_map.metrics.score import (
    AnswerCounts,
    ExternalScore,
    MapScore,
    MethodKind,
    MethodRecord,
    Score,
    StageTime,
)
from sfr_loc_map.metrics.score_json import from_json, to_json
from sfr_loc_map.report.comparison import methods_figures, methods_tables, plain
from sfr_loc_map.report.tables import Table

LATENCY = StageTime(count=9, mean=0.05, sigma=0.01, mean_plus_3sigma=0.08, p50=0.05, p95=0.07, max=0.08)


def of(name: str, kind: MethodKind) -> MethodRecord:
    return MethodRecord(name=name, version="1.2", kind=kind)


@pytest.fixture(scope="module")
def scores() -> list[Score]:
    ours = replace(whole_score(), method=of("sfr", MethodKind.BUILT_IN))
    node = ExternalScore(
        task="localisation", topic="odom", frames="a -> b", answers=AnswerCounts(pairs=9, answered=9), latency_s=LATENCY
    )
    other = replace(ours, method=of("their node", MethodKind.EXTERNAL), timing=None, memory=None, external=node)
    assert ours.map is not None
    return [ours, other]


def cells(table: Table) -> dict[str, list[str]]:
    """The texts of the rows by title of column."""
    return {column.title: [row[k].text for row in table.rows] for k, column in enumerate(table.columns)}


def test_each_method_has_a_row_and_a_latency_is_no_time_per_call(scores: list[Score]) -> None:
    methods = cells(methods_tables(scores, ["sfr", "their node"])[0])
    assert methods["method"] == ["sfr", "their node"]
    assert methods["kind"] == ["built-in", "external"]
    assert methods["time p50"][1] == "latency 50"
    assert "latency" not in methods["time p50"][0]
    assert " / " in methods["memory"][0]
    assert methods["memory"][1] == "-"
    first = scores[0].trajectory
    assert first is not None
    total = first.first.position_m.mean_plus_3sigma
    assert total is not None
    assert methods[f"position over {first.first.condition.label}"][0].startswith(f"{1e3 * total:.4g}")


def test_maps_stand_as_differences_from_the_first(scores: list[Score]) -> None:
    part = scores[1].map
    assert isinstance(part, MapScore)
    assert part.errors is not None
    worse = [
        replace(item, point_error_m=replace(item.point_error_m, p50=2.0 * (item.point_error_m.p50 or 0.0)))
        for item in part.errors.by_range
    ]
    other = replace(scores[1], map=replace(part, errors=replace(part.errors, by_range=tuple(worse))))
    (table,) = [item for item in methods_tables([scores[0], other], ["a", "b"]) if item.name == "map-differences"]
    shown = cells(table)
    known = [k for k, text in enumerate(shown["p50 of a"]) if text not in ("-", "0")]
    assert known
    for k in known:
        assert table.rows[k][4].value == pytest.approx(table.rows[k][2].value)
    assert [row[8].value for row in table.rows if row[8].value] == []


def test_figures_hold_all_methods_and_no_sign_that_plotly_reads(scores: list[Score]) -> None:
    sections = dict(methods_figures(scores, ["sfr", HOSTILE]))
    plots = {plot.name: plot for group in sections.values() for plot in group}
    assert set(plots) >= {"paths", "errors", "growths", "cost-localisation", "cost-mapping", "map-ranges"}
    assert [trace["name"] for trace in plots["paths"].data] == ["truth", "sfr", plain(HOSTILE)]
    latency = plots["cost-localisation"].data[1]
    assert latency["name"].endswith("(latency)")
    assert latency["marker"]["symbol"].endswith("-open")
    assert latency["x"] == [50.0]
    assert not set("<>&") & set(plain(HOSTILE))
    assert methods_figures([Score(verdicts=())] * 2, ["a", "b"]) == []


def test_the_command_names_methods_and_writes_page_and_json(scores: list[Score], tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.json" for number in range(2)]
    for path, score in zip(paths, scores, strict=True):
        path.write_text(to_json(score))
        assert from_json(path.read_text()) == score
    page, found = tmp_path / "page.html", tmp_path / "compared.json"
    result = CliRunner().invoke(app, ["compare", *map(str, paths), "--html", str(page), "--json", str(found)])
    assert result.exit_code == 0, result.output
    content = json.loads(found.read_text())
    assert content["names"] == ["sfr", "their node"]
    assert [method["kind"] for method in content["methods"]] == ["built-in", "external"]
    text = page.read_text()
    for words in ("their node", "What each was made of", "Cost against accuracy", "sfr_loc_map"):
        assert words in text
    same = CliRunner().invoke(app, ["compare", str(paths[0]), str(paths[0])])
    assert "their node" not in same.output
