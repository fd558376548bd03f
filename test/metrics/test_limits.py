"""Limits of a file: verdicts on figures, each found by its name, and files that are refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from random_drives import drive, score_of

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.calls import HOST_CLOCK, call_score
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.limits import parse_limits, verdicts
from sfr_loc_map.metrics.score import MapScore, MemoryScore, PeakMemory, Score, TargetScore, TimingScore

LIMIT = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.5}]}


def judge(content: dict[str, Any], score: Score) -> list[str]:
    return [item.state for item in verdicts(parse_limits(content, "limits"), score)]


def with_position(total: float | None, interval: tuple[float, float] | None = None, count: int = 20) -> Score:
    """A score of two conditions whose position over 5 m has a mean + 3 sigma, and whose heading is 0.6 deg off."""
    truth, estimate = drive(1)
    score = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("time=3", "distance=5")))
    assert score.trajectory is not None
    other, part = score.trajectory.several
    position = replace(part.position_m, mean_plus_3sigma=total, mean_plus_3sigma_ci95=interval)
    part = replace(part, position_m=position, heading_deg=replace(part.heading_deg, mean=-0.6), count=count)
    return replace(score, trajectory=replace(score.trajectory, several=(other, part)))


def test_pass_fail_and_not_enough_data() -> None:
    assert [judge(LIMIT, with_position(total))[0] for total in (0.4, 0.5, 0.6)] == ["pass", "pass", "fail"]
    assert judge(LIMIT, with_position(None, count=1)) == ["not enough data"]
    assert judge({**LIMIT, "minimum_count": 30}, with_position(0.6)) == ["not enough data"]
    assert judge(LIMIT, Score(verdicts=())) == ["not enough data"]
    signed = {"trajectory": [{"condition": "distance=5", "heading_mean_deg": 0.5}]}
    assert judge(signed, with_position(0.4)) == ["fail"], "a signed mean is judged by its size"
    verdict = verdicts(parse_limits(LIMIT, "limits"), with_position(0.4, (0.3, 0.7)))[0]
    assert (verdict.state, verdict.certain, verdict.ci95) == ("pass", False, (0.3, 0.7))


def test_coverage_is_a_lower_bound_and_times_have_counts() -> None:
    content = {"map": {"coverage_min": 0.8}, "timing": {"localisation_p95_s": 0.1}, "memory": {"mapping_peak_bytes": 9}}
    score = Score(
        map=MapScore(pairs=1, points=2, coverage=0.9, coverage_range_m=(0.0, 10.0), nearest_only=True),
        timing=TimingScore(localisation=call_score(np.array([0.5]), HOST_CLOCK)),
        memory=MemoryScore(mapping=PeakMemory(peak_bytes=10, above_idle_bytes=None)),
        verdicts=(),
    )
    assert judge(content, score) == ["pass", "not enough data", "fail"]
    assert judge({"map": {"coverage_min": 0.95}}, score) == ["fail"]
    judged = replace(score, verdicts=verdicts(parse_limits(content, "limits"), score))
    assert [item.metric for item in judged.failed] == ["mapping_peak_bytes"]


@pytest.mark.clause("4.2.1")
def test_the_target_is_judged_by_its_own_figures() -> None:
    timing = TimingScore(localisation=call_score(np.array([0.5, 0.7]), "GR740"))
    score = Score(target=TargetScore(name="GR740", timing=timing, memory=MemoryScore()), verdicts=())
    content = {"target": {"localisation_max_s": 0.6, "localisation_peak_bytes": 5}, "timing": {"localisation_max_s": 1}}
    got = verdicts(parse_limits(content, "limits"), score)
    assert [(item.metric, item.state, item.value) for item in got] == [
        ("localisation_max_s", "not enough data", None),
        ("target localisation_max_s", "fail", 0.7),
        ("target localisation_peak_bytes", "not enough data", None),
    ]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"trajectry": []}, "did you mean 'trajectory'"),
        ({"trajectory": [{"condition": "distance=5", "position_mean_mm": 5}]}, "position_mean_m"),
        ({"trajectory": [{"position_mean_m": 5}]}, "needs 'condition'"),
        ({"map": {"coverage_min": float("nan")}}, "a number >= 0"),
        ({"map": [1]}, "a mapping"),
        ({"minimum_count": 1, "map": {"coverage_min": 0.8}}, "minimum_count"),
        ({}, "no limit"),
    ],
)
def test_malformed_limits_are_refused_in_one_line(content: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        parse_limits(content, "limits.yaml")
    assert "\n" not in str(caught.value)
