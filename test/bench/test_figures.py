"""Medians, ratios and growth, worked out by hand."""

from __future__ import annotations

import pytest

from sfr_loc_map.bench.figures import cost_figures, growth, growths, median, ratios


def test_median_of_nested_figures_takes_those_that_are_known() -> None:
    runs = [
        {"a": {"x": 1.0, "y": None}, "n": 3, "name": "p"},
        {"a": {"x": 5.0, "y": 7.0}, "n": 4, "name": "p"},
        {"a": {"x": 2.0, "y": None}, "n": 9, "name": "p"},
    ]
    assert median(runs) == {"a": {"x": 2.0, "y": 7.0}, "n": 4.0, "name": "p"}
    assert median([{"a": None}, {"a": None}]) == {"a": None}


def test_ratio_is_ours_by_theirs_in_size() -> None:
    ours = {"t": {"p50": 2.0, "p95": 3.0}, "bias": -0.1, "zero": 1.0, "none": None, "text": "a", "mine": 1.0}
    theirs = {"t": {"p50": 8.0, "p95": 2.0}, "bias": 0.2, "zero": 0.0, "none": 1.0, "text": "b"}
    assert ratios(ours, theirs) == {"t": {"p50": 0.25, "p95": 1.5}, "bias": 0.5, "zero": None}


def test_growth_is_the_power_of_the_work() -> None:
    assert growth([100, 400, 1600], [1.0, 8.0, 64.0]) == pytest.approx(1.5)
    assert growth([100], [1.0]) is None
    sizes = [
        {"width": side, "height": side, "entries": {"ours": {"time_s": {"p50": side}}} | other}
        for side, other in ((16, {"a": {"time_s": {"p50": 1.0}}}), (8, {}))
    ]
    assert growths(sizes) == {"ours": pytest.approx(0.5)}
    searched = [size | {"disparities": size["width"] ** 2} for size in sizes]
    assert growths(searched) == {"ours": pytest.approx(0.25)}


def test_costs_of_calls() -> None:
    figures = cost_figures([0.4, 0.1, 0.2, 0.3, 0.5], [10, None, 30, 20, 5], 7)
    assert figures["time_s"] == {"p50": 0.3, "p95": pytest.approx(0.48), "max": 0.5, "first": 0.4}
    assert figures["memory_bytes"] == {"peak": 30, "idle": 7}
    assert cost_figures([], [], None)["time_s"]["p50"] is None
