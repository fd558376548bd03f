"""A history finds what became worse, and does not cry wolf; drives are drawn from simulated sub-trajectories."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.suite.figure_table import FigureKind, FigureName
from sfr_loc_map.suite.history import HistoryRun, find_changes

POSITION = FigureName(FigureKind.ACCURACY, "position over 5 m, m")
DRIVES, ROWS = 20, 30


def errors(rng: np.random.Generator) -> np.ndarray:
    """Return errors `(drive, sub-trajectory, axis)`: drives differ, neighbours share most of their error."""
    size = np.exp(rng.normal(np.log(0.003), 0.4, (DRIVES, 1, 1)))
    steps = rng.normal(size=(DRIVES, ROWS + 4, 3))
    return size * np.stack([steps[:, k : k + ROWS] for k in range(5)]).sum(axis=0) / np.sqrt(5.0)


def run_of(name: str, rows: np.ndarray) -> HistoryRun:
    figure = np.linalg.norm(rows.mean(axis=1), axis=1) + 3.0 * np.linalg.norm(rows.std(axis=1, ddof=1), axis=1)
    return HistoryRun(name=name, figures={str(n): {POSITION: float(value)} for n, value in enumerate(figure)})


def changed(rng: np.random.Generator, rows: np.ndarray, factor: float) -> np.ndarray:
    """Return the errors of other code: each differs by a tenth of the typical error of its drive, by chance."""
    scatter = 0.1 * rows.std(axis=(1, 2), keepdims=True)
    return factor * (rows + rng.normal(size=rows.shape) * scatter)


def alarms(factor: float, seed: int) -> int:
    found = 0
    for trial in range(100):
        rng = np.random.default_rng([seed, trial])
        rows = errors(rng)
        runs = [run_of("before", rows), run_of("after", changed(rng, rows, factor))]
        found += find_changes(runs).first_worse == {"accuracy": "after"}
    return found


def test_at_most_one_false_alarm_in_a_hundred_pairs_of_equal_commits() -> None:
    assert alarms(1.0, 1) <= 1


def test_ten_per_cent_more_error_is_found_in_95_of_100() -> None:
    assert alarms(1.1, 2) >= 95


def test_the_first_worse_run_is_named_and_a_better_one_is_the_new_baseline() -> None:
    rng = np.random.default_rng(3)
    rows = errors(rng)
    factors = {"a": 1.0, "b": 1.0, "c": 0.8, "d": 0.92, "e": 1.3}
    history = find_changes([run_of(name, factor * rows) for name, factor in factors.items()])
    by_run = {point.run: point for point in history.points}
    assert [by_run[name].outcome for name in "bcde"] == [
        Outcome.EQUAL,
        Outcome.BETTER,
        Outcome.WORSE,
        Outcome.WORSE,
    ]
    assert (by_run["c"].baseline, by_run["d"].baseline) == ("a", "c")
    assert by_run["d"].ratio == pytest.approx(0.92 / 0.8)
    assert history.first_worse == {"accuracy": "d"}


def test_a_slow_decline_adds_up() -> None:
    rows = errors(np.random.default_rng(4))
    names = [f"{number}" for number in range(8)]
    history = find_changes([run_of(name, 1.004**number * rows) for number, name in enumerate(names)])
    assert history.first_worse == {"accuracy": "3"}


def test_one_run_is_no_history() -> None:
    with pytest.raises(MetricsError, match="two suites"):
        find_changes([run_of("a", errors(np.random.default_rng(0)))])


@pytest.mark.parametrize(("drives", "runs", "found"), [(7, 2, False), (8, 2, True), (20, 201, True)])
def test_what_so_few_drives_cannot_show_is_not_called_no_difference(drives: int, runs: int, found: bool) -> None:
    rows = errors(np.random.default_rng(5))[:drives]
    names = [str(number) for number in range(runs)]
    factors = dict.fromkeys(names, 1.0) | {names[-1]: 1.3}
    history = find_changes([run_of(name, factor * rows) for name, factor in factors.items()])
    assert history.points[-1].outcome is (Outcome.WORSE if found else Outcome.NOT_ENOUGH_DATA)
