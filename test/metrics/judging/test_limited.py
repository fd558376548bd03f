"""The effect of the error of the truth on a limited number."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest

from sfr_loc_map.metrics.formulas import QUANTILES, statistics
from sfr_loc_map.metrics.judging.limited import EXPANSION

COUNT = 20_000  #: Sub-trajectories, so many that the n - 1 of sigma is negligible.
BOUNDED = ("mean", "sigma", "rmse", "mean_plus_3sigma")


def changes(errors: np.ndarray, truth_errors: np.ndarray) -> dict[str, float]:
    """Return the change of each bounded statistic, in multiples of the root mean square of the errors of the truth."""
    before, after = statistics(errors), statistics(errors + truth_errors)
    size = np.sqrt(np.sum(np.square(truth_errors)) / len(truth_errors))
    return {name: abs(getattr(after, name) - getattr(before, name)) / size for name in BOUNDED}


@pytest.mark.parametrize("axes", [(), (3,)])
@pytest.mark.parametrize("seed", range(20))
def test_no_error_of_the_truth_changes_a_statistic_by_more_than_its_factor(axes: tuple[int, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    errors = rng.normal(rng.normal(size=axes), rng.uniform(0.1, 1.0), (COUNT, *axes))
    truth_errors = rng.normal(rng.normal(size=axes), rng.uniform(0.1, 1.0), (COUNT, *axes))
    for name, change in changes(errors, truth_errors).items():
        assert change <= EXPANSION[name] * (1.0 + 1e-4), name


def test_the_worst_error_of_the_truth_changes_each_bounded_statistic_by_its_factor() -> None:
    """The error with a third of its scatter as its mean changes mean + 3 sigma by more than 3 of its sizes."""
    scatter = np.random.default_rng(0).normal(size=COUNT)
    scatter = (scatter - np.mean(scatter)) / np.std(scatter)
    errors = 5.0 + scatter
    worst = {"mean": np.ones(COUNT), "sigma": scatter, "rmse": errors, "mean_plus_3sigma": 1.0 + 3.0 * scatter}
    for name, truth_errors in worst.items():
        assert changes(errors, truth_errors)[name] == pytest.approx(EXPANSION[name], rel=1e-3), name


def test_the_factor_of_a_quantile_is_at_least_that_of_a_normal_error() -> None:
    for name, percent in QUANTILES.items():
        quantile = NormalDist().inv_cdf(0.5 + percent / 200.0)
        assert quantile <= EXPANSION[name] < quantile + 1.0, name
