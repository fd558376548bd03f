from pathlib import Path
from typing import Any

import pytest

from sfr_loc_map.config import load_yaml
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.limits import load_limits, parse_limits, verdicts
from sfr_loc_map.metrics.results import build_score, failed

EXAMPLE = Path(__file__).resolve().parents[2] / "config" / "limits_example.yaml"


def figure(mean: float | None, total: float | None) -> dict[str, Any]:
    return {"mean": mean, "sigma": 0.1, "mean_plus_3sigma": total, "mean_plus_3sigma_ci95": None}


def trajectory(total: float | None, count: int = 20) -> dict[str, Any]:
    return {
        "count": count,
        "condition": {"distance_m": 5.0},
        "position_m": figure(0.1, total),
        "attitude_deg": figure(0.1, total),
        "heading_deg": figure(-0.6, total),
    }


def judge(content: dict[str, Any], score: dict[str, Any]) -> list[str]:
    return [item["verdict"] for item in verdicts(parse_limits(content, "limits"), score)]


LIMIT = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.5}]}


def test_pass_fail_and_not_enough_data() -> None:
    assert judge(LIMIT, {"trajectory": trajectory(0.4)}) == ["pass"]
    assert judge(LIMIT, {"trajectory": trajectory(0.5)}) == ["pass"]
    assert judge(LIMIT, {"trajectory": trajectory(0.6)}) == ["fail"]
    assert judge(LIMIT, {"trajectory": trajectory(None, 1)}) == ["not enough data"]
    assert judge({**LIMIT, "minimum_count": 30}, {"trajectory": trajectory(0.6)}) == ["not enough data"]
    assert judge(LIMIT, {}) == ["not enough data"]


def test_signed_mean_is_judged_by_its_size() -> None:
    content = {"trajectory": [{"condition": "distance=5", "heading_mean_deg": 0.5}]}
    assert judge(content, {"trajectory": trajectory(1.0)}) == ["fail"]


def test_the_limit_finds_its_condition_among_several() -> None:
    other = {**trajectory(9.0), "condition": {"time_s": 60.0}}
    score = {"trajectory": {**other, "conditions": [other, trajectory(0.4)]}}
    assert judge(LIMIT, score) == ["pass"]


def test_coverage_is_a_lower_bound_and_times_have_counts() -> None:
    content = {"map": {"coverage_min": 0.8}, "timing": {"localisation_p95_s": 0.1}, "memory": {"mapping_peak_bytes": 9}}
    score = {
        "map": {"coverage": 0.9},
        "timing": {"localisation_s": {"count": 1, "p95": 0.5}},
        "memory": {"mapping_peak_bytes": 10},
    }
    assert judge(content, score) == ["pass", "not enough data", "fail"]
    built = build_score(score, limits=parse_limits(content, "limits"))
    assert [item["metric"] for item in failed(built)] == ["mapping_peak_bytes"]


def test_interval_says_whether_the_verdict_is_certain() -> None:
    score = {"trajectory": trajectory(0.4)}
    score["trajectory"]["position_m"]["mean_plus_3sigma_ci95"] = [0.3, 0.7]
    verdict = verdicts(parse_limits(LIMIT, "limits"), score)[0]
    assert (verdict["verdict"], verdict["certain"], verdict["ci95"]) == ("pass", False, [0.3, 0.7])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"trajectry": []}, "did you mean 'trajectory'"),
        ({"map": {"coverage": 0.8}}, "did you mean 'coverage_min'"),
        (
            {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_mm": 5}]},
            "position_mean_plus_3sigma_m",
        ),
        ({"trajectory": [{"position_mean_m": 5}]}, "needs 'condition'"),
        ({"trajectory": [{"condition": "metres=5", "position_mean_m": 5}]}, "no condition"),
        ({"trajectory": {"condition": "distance=5"}}, "must be a list"),
        ({"map": {"coverage_min": "high"}}, "a number >= 0"),
        ({"map": {"coverage_min": True}}, "a number >= 0"),
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


def test_the_example_is_valid_and_says_that_it_is_one() -> None:
    assert load_limits(EXAMPLE).conditions
    assert load_yaml(EXAMPLE)["minimum_count"] >= 2
    assert "EXAMPLE ONLY" in EXAMPLE.read_text(encoding="utf-8")
