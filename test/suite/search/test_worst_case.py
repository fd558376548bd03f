"""The search on functions with a known weakness: number of runs, reduced case, slices and coverage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from sfr_loc_map.suite.search.record import Parameter
from sfr_loc_map.suite.search.specification import Point
from sfr_loc_map.suite.search.worst_case import (
    Chooser,
    RandomChooser,
    TreeChooser,
    TriedPoint,
    coverage_of,
    reduced,
    slices_of,
    tried_points,
)

pytest.importorskip("optuna")
PARAMETERS = [
    Parameter("light.sun_elevation_deg", 0.0, 1.0, 0.5),
    Parameter("terrain.slope_deg", 0.0, 1.0, 0.5),
    Parameter("yaw", 0.0, 1.0, 0.0, fault="yaw"),
    Parameter("sensor.blur_px", 0.0, 1.0, 0.5),
    Parameter("rocks.cover", 0.0, 1.0, 0.5),
]
WEAK = np.array([0.9, 0.1, 0.8])
RUNS = 400


def ratio_at(point: Point) -> float:
    """Return a ratio that exceeds 1 in 0.4 % of the ranges: low sun, no slope, yaw."""
    away = np.square((np.array(point[:3]) - WEAK) / 0.3).sum()
    return 0.2 + 0.1 * point[3] + 0.95 * float(np.exp(-away))


def weak(points: Sequence[Point]) -> list[TriedPoint]:
    return [TriedPoint(point, ratio_at(point)) for point in points]


def harmless(points: Sequence[Point]) -> list[TriedPoint]:
    return [TriedPoint(point, 0.5) for point in points]


def runs_needed(chooser: Chooser) -> int:
    tried = tried_points(chooser, weak, RUNS, 4)
    return next((number for number, item in enumerate(tried, 1) if item.fails), RUNS)


def test_a_planted_weakness_is_found_in_fewer_runs_than_by_chance() -> None:
    searched = [runs_needed(TreeChooser(PARAMETERS, seed)) for seed in range(10)]
    by_chance = [runs_needed(RandomChooser(PARAMETERS, seed)) for seed in range(10)]
    assert max(searched) < RUNS / 4
    assert np.median(searched) < 0.5 * np.median(by_chance)


def test_a_search_chooses_the_same_points_again() -> None:
    one, two = (list(tried_points(TreeChooser(PARAMETERS, 1), weak, 40, 4)) for _ in range(2))
    assert one == two


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (1000000.4, 1000003.0),
        (-1000003.0, -1000000.4),
        (0.12345649, 0.1234567),
        (0.0, 0.123456789),
        (-0.123456789, 0.0),
        (1e-9, 1e6),
        (1e300, 2e300),
        (1.0, 1.0 + 1e-15),
    ],
)
def test_drawn_values_are_within_the_range_and_differ(low: float, high: float) -> None:
    parameter = Parameter("light.sun_elevation_deg", low, high, 0.5)
    for chooser in (RandomChooser([parameter], 1), TreeChooser([parameter], 1)):
        values = [item.point[0] for item in chooser.run_batch(8, harmless)]
        assert all(low <= value <= high for value in values), values
        assert len({*values}) > 2
    case = TriedPoint((0.5, 0.5), 2.0)
    (part,) = slices_of([parameter, PARAMETERS[0]], case, 3, harmless, 2.0)
    assert (part.x[0], len(part.x), part.x[-1]) == (low, 3, high)


def test_the_reduced_case_changes_only_what_it_needs() -> None:
    usual = tuple(parameter.usual for parameter in PARAMETERS)
    (found,) = weak([(0.9, 0.1, 0.8, 0.9, 0.1)])
    case = reduced(found, PARAMETERS, weak)
    assert case.fails
    assert case.point[3:] == usual[3:]
    distances = [abs(at - of) for at, of in zip(case.point, usual, strict=True)]
    assert all(distance <= abs(weak_at - of) for distance, weak_at, of in zip(distances, WEAK, usual, strict=False))
    assert case.badness < 1.05, "expected: just above the limit"
    meets_limit = TriedPoint(usual, 0.3)
    assert reduced(meets_limit, PARAMETERS, weak) is meets_limit


def test_the_reduced_case_of_an_integer_parameter_is_an_integer_and_no_point_is_run_twice() -> None:
    pairs = Parameter("drive.pairs", 0.0, 12.0, 0.0, is_whole=True)
    evaluated: list[Point] = []

    def fails_from_five(points: Sequence[Point]) -> list[TriedPoint]:
        evaluated.extend(points)
        return [TriedPoint(point, 0.25 * point[0]) for point in points]

    assert reduced(TriedPoint((7.0,), 1.75), [pairs], fails_from_five) == TriedPoint((5.0,), 1.25)
    assert evaluated == [(0.0,), (4.0,), (6.0,), (5.0,)]


def test_slices_show_where_the_limit_begins_to_be_missed() -> None:
    case = TriedPoint((0.9, 0.1, 0.8, 0.5, 0.5), 1.1)
    slices = slices_of(PARAMETERS, case, 11, weak, 2.0)
    assert [(cut.first, cut.second) for cut in slices] == [(0, 1), (0, 2), (1, 2)]
    first = slices[0]
    at_weakness = first.ratios[first.y.index(0.1)][first.x.index(0.9)]
    assert at_weakness == pytest.approx(ratio_at(case.point))
    ratios = [ratio for row in first.ratios for ratio in row if ratio is not None]
    assert min(ratios) < 1.0 < max(ratios)


def test_cells_that_were_never_run_are_named() -> None:
    three = PARAMETERS[:3]
    corner = [(0.1, 0.1, 0.1)]
    (card,) = coverage_of(three, corner)
    assert (card.cells, len(card.missing)) == (27, 26)
    everywhere = [(x, y, z) for x in (0.1, 0.5, 0.9) for y in (0.1, 0.5, 0.9) for z in (0.1, 0.5, 1.0)]
    assert not coverage_of(three, everywhere)[0].missing
