"""Path lengths and ends of sub-trajectories against the plainest computation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.config import Condition, ConditionKind
from sfr_loc_map.metrics.sub_trajectories import KINDS, Progress, find_ends, path_lengths


def test_a_million_steps_lose_nothing() -> None:
    positions = np.zeros((100_001, 3))
    positions[:, 0] = 0.1 * np.arange(100_001)
    steps = np.diff(positions[:, 0]).tolist()
    got = path_lengths(positions)
    assert got[0].tolist() == [0.0, 0.0]
    assert got[-1].sum() == math.fsum(steps)


@pytest.mark.clause("4.1.1")
@pytest.mark.parametrize(("text", "kind"), [("distance=1.5", "path"), ("time=2", "time"), ("frames=7", "frames")])
def test_ends_are_the_first_frames_that_meet_the_condition(text: str, kind: str) -> None:
    rng = np.random.default_rng(1)
    steps = rng.uniform(0, 0.3, 200) * (rng.random(200) > 0.3)
    path, stamps = np.cumsum(steps), np.cumsum(rng.integers(1, 10**9, 200))
    condition = Condition.parse(text)
    progress = Progress(stamps, np.column_stack((path, 0 * path)))
    got = find_ends(np.arange(0, 200, 3), progress, KINDS[condition.kind], condition.threshold)
    measured = {"path": path, "time": stamps, "frames": np.arange(200)}[kind]
    least = condition.threshold - (1e-9 if kind == "path" else 0.0)
    for start, end in zip(range(0, 200, 3), got.tolist(), strict=True):
        met = [k for k in range(start + 1, 200) if measured[k] - measured[start] >= least]
        assert end == (met[0] if met else 200)


@given(st.sampled_from(ConditionKind), st.integers(1, 10**6))
def test_every_spelling_of_a_condition_reads_back(kind: ConditionKind, value: int) -> None:
    condition = Condition(kind, float(value))
    assert Condition.parse(condition.setting) == condition
    assert Condition.from_plain(condition.to_plain()) == condition
    assert condition.label == f"{value:g} {kind.unit}" == str(condition)


@pytest.mark.parametrize(
    "value", [None, {}, {"distance_m": True}, {"distance_m": 1, "time_s": 2}, {"frames": 1.5}, {"time_s": 1e300}, 5]
)
def test_what_is_no_condition_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match=r"condition|ends no"):
        Condition.from_plain(value)
    with pytest.raises(MetricsError, match="is not a condition"):
        Condition.parse(str(value))
    with pytest.raises(MetricsError, match="is not a condition"):
        Condition.parse("time=1e300")
