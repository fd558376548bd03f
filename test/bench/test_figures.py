"""Medians, ratios and growth, worked out by hand."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from sfr_loc_map.bench.figures import CallCosts, growth, median, ratios
from sfr_loc_map.bench.localisation_benchmark import LocalisationFigures
from sfr_loc_map.bench.results import Entry, SizeResult, growth_by_method


@dataclass(frozen=True)
class Inner:
    x: float
    y: float | None


@dataclass(frozen=True)
class Outer:
    a: Inner | None
    n: float
    name: str
    parts: dict[str, Inner]


def test_median_of_nested_figures_takes_those_that_are_known() -> None:
    runs = [
        Outer(Inner(1.0, None), 3, "p", {"far": Inner(4.0, 1.0)}),
        Outer(Inner(5.0, 7.0), 4, "p", {}),
        Outer(Inner(2.0, None), 9, "p", {"far": Inner(6.0, 1.0)}),
    ]
    assert median(runs) == Outer(Inner(2.0, 7.0), 4.0, "p", {"far": Inner(5.0, 1.0)})
    assert median([Outer(None, 1, "p", {})] * 2) == Outer(None, 1.0, "p", {})


def test_ratio_is_ours_by_theirs_in_size() -> None:
    ours = {"t": {"p50": 2.0, "p95": 3.0}, "bias": -0.1, "zero": 1.0, "none": None, "text": "a", "mine": 1.0}
    theirs = {"t": {"p50": 8.0, "p95": 2.0}, "bias": 0.2, "zero": 0.0, "none": 1.0, "text": "b"}
    assert ratios(ours, theirs) == {"t": {"p50": 0.25, "p95": 1.5}, "bias": 0.5, "zero": None}


def size(side: int, disparities: int | None, **seconds: float) -> SizeResult[LocalisationFigures]:
    entries = {
        name: Entry("1", [LocalisationFigures(0, None, CallCosts.of([time_s], [None], None))])
        for name, time_s in seconds.items()
    }
    return SizeResult(side, side, disparities, entries, {})


def test_growth_is_the_power_of_the_work() -> None:
    assert growth([100, 400, 1600], [1.0, 8.0, 64.0]) == pytest.approx(1.5)
    assert growth([100], [1.0]) is None
    pixels = [size(16, None, ours=16.0, other=1.0), size(8, None, ours=8.0)]
    assert growth_by_method(pixels) == {"ours": pytest.approx(0.5)}
    searched = [size(side, side**2, ours=float(side)) for side in (16, 8)]
    assert growth_by_method(searched) == {"ours": pytest.approx(0.25)}


def test_costs_of_calls() -> None:
    costs = CallCosts.of([0.4, 0.1, 0.2, 0.3, 0.5], [10, None, 30, 20, 5], 7)
    assert costs.to_json() == {
        "time_s": {"p50": 0.3, "p95": pytest.approx(0.48), "max": 0.5, "first": 0.4},
        "memory_bytes": {"peak": 30, "idle": 7},
        "calls": 5,
    }
    assert CallCosts.of([], [], None).time_s.p50 is None


def test_entry_shows_medians_and_each_run() -> None:
    runs = [LocalisationFigures(lost, None, CallCosts.of([time_s], [8], 4)) for lost, time_s in ((0, 1.0), (2, 3.0))]
    shown = Entry("7.1", runs).to_json()
    assert (shown["version"], shown["lost"], shown["time_s"]["p50"]) == ("7.1", 1.0, 2.0)
    assert [run["lost"] for run in shown["runs"]] == [0, 2]
    assert "accuracy" not in shown
    assert Entry("evo", runs).to_json("what")["what"] == "evo"
