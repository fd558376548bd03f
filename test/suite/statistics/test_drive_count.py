"""`sfr suite plan`: the numbers of drives by limit and group."""

from dataclasses import replace

import pytest

from helpers.cli_result import Sfr
from helpers.made_suites import JOB, recording
from helpers.random_drives import drive, score_of
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.judging.proof import sample_of
from sfr_loc_map.suite.pages.tables import drive_count_table
from sfr_loc_map.suite.statistics.drive_count import drive_counts
from sfr_loc_map.suite.statistics.scored_job import ScoredJob
from sfr_loc_map.tables.formats import to_markdown


def limits_with(**entry: object) -> object:
    return parse_limits({"trajectory": [{"condition": "distance=5", "position_bound_m": entry}]}, "limits")


def test_drives_that_are_missing_follow_from_those_seen() -> None:
    drives = []
    for number in range(12):
        truth, estimate = drive(number, count=60)
        score = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("distance=5",)))
        drives.append(ScoredJob(replace(JOB, source=recording(str(number), sha256=str(number))), score))
    terms = {"prob": 0.95, "confidence": 0.95, "interpretation": "ensemble"}
    (count,) = drive_counts(drives, limits_with(limit=10.0, **terms))
    assert (count.drives, count.failures, count.without_failure, count.at_the_rate_seen) == (12, 0, 59, 59)
    assert 2 <= count.if_normal < 59
    assert (count.fixed, count.allowed) == (153, 3)
    assert count.sequential_at_none < count.sequential < count.fixed
    assert count.state == "not enough data"
    (bad,) = drive_counts(drives, limits_with(limit=0.0, **terms))
    assert (bad.failures, bad.at_the_rate_seen, bad.if_normal, bad.state) == (12, None, None, "fail")
    assert "no number" in to_markdown([drive_count_table([bad])], "plan")
    with pytest.raises(ConfigError, match="limits with 'prob'"):
        list(drive_counts(drives, None))


def test_good_drives_at_the_beginning_do_not_hide_a_failure_over_all_drives() -> None:
    """The test passes after two good drives. Two bad drives after them fail it together with the good ones."""
    scored = []
    for number in range(4):
        truth, estimate = drive(number, count=60)
        scored.append(score_of(estimate, truth, TrajectoryScoreConfig(conditions=("distance=5",))))
    largest = [float(sample_of(score, "position", "distance=5").sizes.max()) for score in scored]
    by_error = [score for _, score in sorted(zip(largest, scored, strict=True), key=lambda item: item[0])]
    drives = [
        ScoredJob(replace(JOB, source=recording(str(number), sha256=str(number))), score)
        for number, score in enumerate(by_error)
    ]
    terms = {"prob": 0.5, "confidence": 0.5, "power": 0.5, "good": 0.1, "interpretation": "ensemble"}
    limits = limits_with(limit=0.5 * sum(sorted(largest)[1:3]), **terms)
    assert next(drive_counts(drives[:2], limits)).state == "pass"
    assert next(drive_counts(drives, limits)).state == "fail"


def test_the_command_plans_without_a_suite(sfr: Sfr) -> None:
    result = sfr("suite", "plan", "--prob", "0.99", "--confidence", "0.95", "--json", "-")
    assert '"without_failure": 299' in result.out or '"without_failure":299' in result.out
    assert sfr("suite", "plan", "--prob", "99").code == 2
    assert sfr("suite", "plan", "--prob", "0.95", "--good", "0.06").code == 2
