"""Two suites compared: paired by drive, decided over all of them, corrected for the number of comparisons."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.suite.comparison import compare_suites
from sfr_loc_map.suite.groups import Drive
from sfr_loc_map.suite.summary import Summary

POSITION = "position over 1 m, m"


def scaled(score: Score, factor: float) -> Score:
    trajectory = score.trajectory
    assert trajectory is not None
    position = trajectory.first.position_m
    assert position.mean_plus_3sigma is not None
    larger = replace(position, mean_plus_3sigma=factor * position.mean_plus_3sigma)
    return replace(score, trajectory=replace(trajectory, first=replace(trajectory.first, position_m=larger)))


def summary(score: Score, factors: dict[str, float], configuration: str = "default") -> Summary:
    drives = tuple(
        Drive(
            key=name,
            label=name,
            task="localise",
            source=name,
            configuration=configuration,
            faults="",
            repeat=0,
            pairing=name,
            seconds=None,
            score=scaled(score, factor),
        )
        for name, factor in factors.items()
    )
    counts = {"tasks": len(drives), "done": len(drives), "failed": 0, "waiting": 0}
    return Summary(**counts, groups=(), drives=drives, failures=(), again=(), refusals=(), code="")


def names(count: int) -> list[str]:
    return [f"drive {number}" for number in range(count)]


def test_errors_larger_on_every_drive_are_worse(score: Score) -> None:
    rng = np.random.default_rng(0)
    factors = {name: float(rng.uniform(1.02, 1.3)) for name in names(10)}
    before = summary(score, dict.fromkeys(names(10), 1.0))
    result = compare_suites(before, summary(score, factors, "new"), ("a", "b"))
    by_name = {item.figure: item for item in result.figures}
    found = by_name[POSITION]
    assert found.outcome is Outcome.WORSE
    assert found.ratio == pytest.approx(np.exp(np.mean(np.log(list(factors.values())))))
    assert found.ci95 is not None
    assert found.ci95[0] < found.ratio < found.ci95[1]
    assert (found.p, found.p_corrected) == (2 / 2**10, pytest.approx(2 / 2**10 * len(by_name)))
    assert found.worst.label == max(factors, key=lambda name: factors[name])
    assert by_name["heading over 1 m, deg"].outcome is Outcome.EQUAL


def test_one_bad_drive_decides_nothing(score: Score) -> None:
    factors = dict.fromkeys(names(10), 1.0) | {"drive 3": 30.0}
    result = compare_suites(summary(score, dict.fromkeys(names(10), 1.0)), summary(score, factors), ("a", "b"))
    found = next(item for item in result.figures if item.figure == POSITION)
    assert found.outcome is Outcome.NO_DIFFERENCE
    assert (found.worst.label, found.worst.other / found.worst.first) == ("drive 3", pytest.approx(30.0))


def test_drives_of_one_suite_only_are_counted(score: Score) -> None:
    both = compare_suites(
        summary(score, dict.fromkeys(["x", "y", "z"], 1.0)), summary(score, dict.fromkeys(["y"], 2.0)), ("a", "b")
    )
    assert (both.common, both.left_out) == (1, (2, 0))
    assert next(item for item in both.figures if item.figure == POSITION).outcome is Outcome.NOT_ENOUGH_DATA
    with pytest.raises(MetricsError, match="no drive in common"):
        compare_suites(summary(score, {"x": 1.0}), summary(score, {"y": 1.0}), ("a", "b"))


def test_the_file_of_a_comparison_is_plain(score: Score, tmp_path: Path) -> None:
    one = summary(score, dict.fromkeys(names(7), 1.0))
    plain = compare_suites(one, one, ("a", "b")).to_dict()
    assert plain["schema"] == "sfr-suite-comparison/1"
    assert plain["common"] == 7
