"""The trajectory score: as the plain reference says, by hand, and in the cases that are easily got wrong."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers import metrics_reference as reference
from helpers.random_drives import Poses, as_score, corrupted, drive, rows, trajectory
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.conditions import Condition, ConditionKind
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory

CONDITIONS = ("distance=5", "distance=0.3", "time=3", "frames=17")
FIGURES = ("position", "attitude", "heading")


def scored(estimate: Poses, truth: Poses, *conditions: str, lost: Any = None, **config: Any) -> Score:
    """The score over every frame as a start, unless a spacing is given."""
    config = {"spacing": 1, "conditions": conditions or ("distance=5",), **config}
    estimates = Estimates.of(trajectory(estimate), lost)
    return as_score(score_trajectory(estimates, trajectory(truth), TrajectoryScoreConfig(**config)))


def compare(got: Score, wanted: dict[str, Any], part: str) -> None:
    assert got.association.matched == wanted["matched"]
    for name in FIGURES:
        row = got.figure(name, part=part)
        assert row.n == wanted["count"]
        for key, value in zip(("mean", "sigma", "mean_plus_3sigma"), wanted[name], strict=True):
            expected = None if math.isnan(value) else pytest.approx(value, abs=1e-9)
            assert row.statistic(key) == expected, (name, key)


@pytest.mark.clause("4.1.1", "4.1.2", "4.1.3", "4.2.3.1", "4.2.3.2", "4.2.3.3")
@pytest.mark.parametrize("rebase", ["pose", "displacement", "position"])
@pytest.mark.parametrize("seed", range(16))
def test_agrees_with_the_plain_reference(seed: int, rebase: str) -> None:
    truth, estimate = drive(seed, 40 + 5 * seed, turns=seed % 2 == 0, stand=seed % 3 == 0)
    if seed % 4 == 1:
        estimate, truth = corrupted(estimate, seed), corrupted(truth, seed + 1, keep=0.8)
    if seed % 4 == 2:
        estimate = rows(estimate, slice(7, -9))
    if seed % 4 == 3:
        truth = rows(truth, slice(None, None, 2))
    condition, spacing = CONDITIONS[seed // 4], 1 + seed % 11
    kind, _, value = condition.partition("=")
    got = scored(estimate, truth, condition, spacing=spacing, rebase=rebase)
    assert got.figure("position").part == rebase
    for part in ("pose", "displacement", "position"):
        compare(got, reference.score(estimate, truth, kind, float(value), spacing, part), part)


@pytest.mark.clause("4.1.1")
def test_a_distance_reached_exactly_ends_the_sub_trajectory() -> None:
    count = 200
    positions = np.column_stack((np.cumsum(np.full(count, 0.1)), np.zeros((count, 2))))
    poses = (np.arange(count) * 100_000_000, positions, np.tile([0.0, 0, 0, 1], (count, 1)))
    found = scored(poses, poses).details.trajectory.sub_trajectories[0]
    assert np.subtract(found.end_frame, found.start_frame).tolist() == [50] * (count - 50)


@pytest.mark.clause("4.1.3", "4.2.3.1", "4.2.3.2")
def test_golden_statistics_by_hand() -> None:
    """Straight drive of 1 m steps; estimates stray by known vectors: mean (0.1, 0, 0) +- 0.1 along x."""
    stamps, quats = np.arange(4) * 1_000_000_000, np.tile([0.0, 0, 0, 1], (4, 1))
    along, strayed = ([[x, 0.0, 0.0] for x in xs] for xs in ([0.0, 1, 2, 3], [0.0, 1, 2.1, 3.3]))
    got = scored((stamps, np.array(strayed), quats), (stamps, np.array(along), quats), "distance=1")
    position, attitude = got.figure("position"), got.figure("attitude")
    assert position.n == 3
    assert [position.mean, position.sigma, position.mean_plus_3sigma] == pytest.approx([0.1, 0.1, 0.4])
    assert (attitude.mean, attitude.sigma, attitude.mean_plus_3sigma) == (0.0, 0.0, 0.0)


@pytest.mark.clause("4.2.3.3")
def test_heading_mean_is_signed_and_its_sum_is_not() -> None:
    truth, _ = drive(3, 30)
    turned = truth[2].copy()
    for k, (x, y, z, w) in enumerate(truth[2]):
        s, c = math.sin(math.radians(-0.25 * k)), math.cos(math.radians(-0.25 * k))
        turned[k] = (c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z)
    heading = scored((truth[0], truth[1], turned), truth, "frames=2").figure("heading")
    assert heading.mean == pytest.approx(-1.0, abs=1e-9)
    assert heading.mean_plus_3sigma == pytest.approx(1.0, abs=1e-6)


@pytest.mark.clause("4.1.3")
def test_one_sub_trajectory_has_a_mean_but_no_sigma() -> None:
    truth, estimate = drive(1, 30)
    got = scored(estimate, truth, "frames=20", "frames=1000", spacing=10)
    one, none = got.figure("position", condition="frames=20"), got.figure("attitude", condition="frames=1000")
    assert (one.n, one.sigma, one.mean_plus_3sigma) == (1, None, None)
    assert one.mean is not None
    assert (none.n, none.mean) == (0, None)


@given(st.sampled_from(ConditionKind), st.integers(1, 180))
def test_every_spelling_of_a_condition_reads_back(kind: ConditionKind, value: int) -> None:
    condition = Condition.parse(f"{kind}={value}.0")
    assert condition.setting == f"{kind}={value}"
    assert Condition.parse(condition.setting) == condition
    assert Condition.parse(f"{kind}={value} {kind.unit}") == condition
    assert condition.label == str(condition)
    assert condition.label.startswith(f"{value:g} {kind.unit}")


def test_what_is_no_condition_is_refused() -> None:
    for text in (
        "distance=0",
        "distance=-1",
        "distance",
        "time=nan",
        "time=1e300",
        "frames=1.5",
        "turn=181",
        "speed=3",
        "",
    ):
        with pytest.raises(MetricsError, match="is not a condition"):
            Condition.parse(text)


def test_error_by_direction_of_travel() -> None:
    """Driving north; the estimate is 1 % short, drifts 2 % to the right (east) and 3 % up."""
    north = 0.1 * np.arange(101)
    quat = np.tile([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)], (101, 1))
    stamps = np.arange(101) * 100_000_000
    truth = (stamps, np.column_stack((0 * north, north, 0 * north)), quat)
    estimate = (stamps, np.column_stack((0.02 * north, 0.99 * north, 0.03 * north)), quat)
    got = scored(estimate, truth, spacing=10)
    wanted = {"x": 0.1, "y": -0.05, "z": 0.15, "along": -0.05, "cross": -0.1}
    means = {part: got.number("position", "mean", part=part) for part in wanted}
    assert means == pytest.approx(wanted, abs=1e-12)
    by_distance = {row.part: row.mean for row in got.rows("position", condition=None)}
    counts = {row.part: row.n for row in got.rows("position", condition=None)}
    assert counts == {"1 m": 10, "2 m": 9, "5 m": 6, "10 m": 1}, "starts are ten frames apart"
    length = math.sqrt(0.01**2 + 0.02**2 + 0.03**2)
    assert by_distance == pytest.approx({f"{d} m": d * length for d in (1, 2, 5, 10)}, abs=1e-12)
