"""Pooled errors: their statistics are those of all values together, and their interval has the stated coverage."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.made_suites import scored_job
from helpers.random_drives import drive, trajectory
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.formulas import statistics
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_errors import error_figures
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.suite.statistics.pooling import pool, pooled_row


def rows_of(values: np.ndarray) -> list[Figure]:
    """A row an axis."""
    return [
        figure_row("position", "distance=5", axis, n=len(column), mean=float(column.mean()), sigma=column.std(ddof=1))
        for axis, column in zip("xyz", values.T, strict=False)
    ]


def pooled(drives: list[np.ndarray], names: list[str]) -> Figure:
    of_drives: dict[str, list[list[Figure]]] = {}
    for name, values in zip(names, drives, strict=True):
        of_drives.setdefault(name, []).append(rows_of(values))
    return pooled_row("position", "distance=5", of_drives)


@settings(max_examples=20)
@given(
    sizes=st.lists(st.integers(2, 9), min_size=1, max_size=6),
    axes=st.sampled_from([1, 3]),
    seed=st.integers(0, 2**32 - 1),
    offset=st.sampled_from([0.0, 5.0, -300.0]),
)
def test_pooled_is_the_statistic_of_all_values(sizes: list[int], axes: int, seed: int, offset: float) -> None:
    rng = np.random.default_rng(seed)
    drives = [rng.normal(rng.normal() + offset, rng.uniform(0.1, 3.0), (size, axes)) for size in sizes]
    found = pooled(drives, [*map(str, range(len(drives)))])
    every = np.concatenate(drives)
    mean, sigma = np.linalg.norm(every.mean(axis=0)), np.linalg.norm(every.std(axis=0, ddof=1))
    assert found.mean == pytest.approx(every.mean() if axes == 1 else mean, rel=1e-9, abs=1e-9)
    assert abs(found.mean) == pytest.approx(mean, rel=1e-9, abs=1e-9)
    assert found.sigma == pytest.approx(sigma, rel=1e-9)
    assert found.mean_plus_3sigma == pytest.approx(mean + 3 * sigma, rel=1e-9)
    assert (found.n, found.independent) == (len(every), len(drives))
    assert (found.interval is None) == (len(sizes) < 5)
    repeated = pooled(drives, ["one"] * len(drives))
    assert (repeated.mean, repeated.interval) == (found.mean, None)  # repeats of one drive
    one = Score(figures=tuple(figure_row("position", "distance=5", axis, n=1, mean=1.0) for axis in "xyz"))
    assert [row.mean for row in pool([scored_job("a", one)], "distance=5")] == [None], "one value has no sigma"


def test_the_interval_holds_the_true_figure_nine_times_in_ten_at_least() -> None:
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(60):
        drives = [rng.normal(0.0, 1.0, (30, 3)) * np.exp(rng.normal(0.0, 0.3)) for _ in range(15)]
        low, high = pooled(drives, [*map(str, range(15))]).interval
        held += low <= 3.0 * np.sqrt(3.0 * np.exp(2 * 0.3**2)) <= high
    assert held >= 52


def test_the_mean_of_a_signed_figure_over_drives_keeps_its_sign() -> None:
    left, right = (figure_row("heading", "distance=5", "pose", n=10, mean=mean, sigma=0.1) for mean in (-0.4, 0.2))
    row = pooled_row("heading", "distance=5", {"a": [[left]], "b": [[right]]})
    assert row.mean == pytest.approx(-0.1)
    assert row.mean_plus_3sigma == pytest.approx(0.1 + 3.0 * row.sigma)


def test_of_several_sources_of_a_drive_the_worst_is_pooled() -> None:
    rng = np.random.default_rng(3)
    good, bad = (Score(figures=tuple(rows_of(scale * rng.normal(0.0, 1.0, (30, 3))))) for scale in (1.0, 2.0))
    found = []
    for scores in ((good, bad), (bad, good)):
        results = [scored_job("drive", score, source) for score, source in zip(scores, "ab", strict=True)]
        (row,) = pool(results, "distance=5")
        found.append(row.mean_plus_3sigma)
    (alone,) = pool([scored_job("drive", bad)], "distance=5")
    assert found == [alone.mean_plus_3sigma] * 2


@pytest.mark.parametrize("has_height", [True, False])
def test_each_figure_of_sub_trajectories_is_pooled_like_all_errors_together(has_height: bool) -> None:
    """The drives have mean errors in several directions, so that norms of their means do not add."""
    condition = "distance=5"
    kinds = error_figures(has_height=has_height)
    kept = [(kind.name, condition) for kind in kinds]
    scores = []
    for seed in range(4):
        true, estimate = (trajectory(poses) for poses in drive(seed, turns=True))
        truth = Truth(true.stamps_ns, true.positions, true.quats_xyzw, has_height=has_height)
        config = TrajectoryScoreConfig(conditions=(condition,), spacing=1)
        scored = score_trajectory(Estimates.of(estimate), truth, config, kept_errors=kept)
        scores.append(Score(figures=scored.figures, association=scored.association, errors=scored.errors))
    rows = {row.figure: row for row in pool([scored_job(str(k), each) for k, each in enumerate(scores)], condition)}
    for kind in kinds:
        errors = np.concatenate([score.all_errors(kind.name, condition) for score in scores])
        expected = statistics(errors if kind.axes else errors[:, 0])
        found = rows.pop(kind.name)
        if not has_height and kind.name in ("position", "chord"):
            assert found.mean is None
            continue
        assert errors.shape[1] == max(len(kind.axes), 1)
        for name in ("n", "mean", "sigma", "mean_plus_3sigma"):
            assert found.statistic(name) == pytest.approx(getattr(expected, name), rel=1e-6), (kind.name, name)
    assert not rows
