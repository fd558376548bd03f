"""Error budgets of drives whose fractions are known by construction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.suite.planning.variants import ErrorSource, variants_of
from sfr_loc_map.suite.statistics.budget import Budget, budget_of, sums_of_errors

PIECES = 10  #: Sub-trajectories of a drive.
SIGMAS = {"noise": np.array([3.0, 1.0, 1.0]), "blur": np.array([1.0, 1.0, 1.0]), "light": np.array([0.3, 0.3, 0.3])}
REST = np.array([0.5, 0.5, 0.5])


def sums_of(errors: FloatArray) -> FloatArray:
    statistics = {axis: (column.mean(), column.std(ddof=1)) for axis, column in zip("xyz", errors.T, strict=True)}
    return sums_of_errors(
        [
            figure_row("position", "distance=5", axis, n=len(errors), mean=mean, sigma=sigma)
            for axis, (mean, sigma) in statistics.items()
        ]
    )


def made_budget(seed: int, drives: int, sigmas: Mapping[str, FloatArray] = SIGMAS, coupling: float = 0.0) -> Budget:
    """Return the budget of drives whose sources add independent errors, and together `coupling` times their product."""
    rng = np.random.default_rng(seed)
    found: dict[str, dict[str, FloatArray]] = {}
    for drive in range(drives):
        own = {name: rng.normal(size=(PIECES, 3)) * sigma for name, sigma in sigmas.items()}
        rest = rng.normal(size=(PIECES, 3)) * REST
        for variant in variants_of([ErrorSource(name) for name in sigmas]):
            active = [own[source.name] for source in variant.active]
            errors = rest + sum(active, np.zeros((PIECES, 3)))
            if len(active) > 1:
                errors = errors + coupling * active[0] * active[1]
            found.setdefault(variant.name, {})[str(drive)] = sums_of(errors)
    return budget_of(list(sigmas), "distance=5", found)


def contains(interval: tuple[float, float] | None, value: float) -> bool:
    assert interval is not None
    return interval[0] <= value <= interval[1]


def test_intervals_contain_the_known_shares_as_often_as_they_state() -> None:
    square = {name: float(np.square(sigma).sum()) for name, sigma in SIGMAS.items()}
    whole = sum(square.values()) + float(np.square(REST).sum())
    alone, removed, total = [], [], []
    for seed in range(30):
        budget = made_budget(seed, drives=12)
        alone += [contains(row.alone.ci95, square[row.source] / whole) for row in budget.rows]
        removed += [contains(row.removed.ci95, square[row.source] / whole) for row in budget.rows]
        total.append(contains(budget.total.ci95, 1.0))
    assert np.mean(alone) > 0.88
    assert np.mean(removed) > 0.88
    assert np.mean(total) > 0.86


def test_mean_and_sigma_by_axis_are_those_of_the_source() -> None:
    budget = made_budget(1, drives=400)
    noise = next(row for row in budget.rows if row.source == "noise")
    assert noise.sigma_m == pytest.approx(SIGMAS["noise"], rel=0.1)
    assert noise.mean_m == pytest.approx([0.0, 0.0, 0.0], abs=0.2)
    assert budget.rms_m == pytest.approx(np.sqrt(11 + 3 + 0.27 + 0.75), rel=0.03)


def test_sources_that_act_together_have_an_interaction_and_shares_that_do_not_add_up() -> None:
    budget = made_budget(2, drives=200, coupling=1.0)
    noise = next(row for row in budget.rows if row.source == "noise")
    assert noise.interaction.ci95 is not None
    assert noise.interaction.ci95[0] > 0.0
    assert budget.total.ci95 is not None
    assert budget.total.ci95[1] < 1.0


def test_two_sources_share_their_variants() -> None:
    two = {name: SIGMAS[name] for name in ("noise", "blur")}
    assert len(variants_of([ErrorSource(name) for name in two])) == 4
    rows = made_budget(3, drives=200, sigmas=two).rows
    assert [row.alone.value for row in rows] == pytest.approx([11 / 14.75, 3 / 14.75], rel=0.15)


def test_few_drives_have_no_interval_and_a_drive_without_a_variant_is_left_out() -> None:
    assert made_budget(4, drives=4).total.ci95 is None
    errors = sums_of(np.ones((PIECES, 3)) + np.arange(PIECES)[:, None])
    found = {variant.name: {"a": errors} for variant in variants_of([ErrorSource("one"), ErrorSource("two")])}
    found["all sources"]["b"] = errors
    budget = budget_of(["one", "two"], "distance=5", found)
    assert (budget.drives, budget.left_out) == (1, 1)
    found["no source"].clear()
    unknown = budget_of(["one", "two"], "distance=5", found)
    assert unknown.rms_m is None
    assert unknown.rows[0].alone.value is None


def test_a_random_amount_is_the_same_in_all_variants_of_a_seed() -> None:
    source = ErrorSource("yaw", fault="yaw", sigma=0.1)
    assert source.fault_of(3) == source.fault_of(3)
    amounts = [float(source.fault_of(seed).partition("amount=")[2]) for seed in range(400)]
    assert np.std(amounts) == pytest.approx(0.1, rel=0.15)
    assert np.mean(amounts) == pytest.approx(0.0, abs=0.02)
    factor = ErrorSource("baseline", fault="baseline", sigma=0.01)
    factors = [float(factor.fault_of(seed).partition("amount=")[2]) for seed in range(400)]
    assert np.mean(factors) == pytest.approx(1.0, abs=0.003)
