"""The head of the report: whose run it is, and what to look at first."""

from __future__ import annotations

from msgspec.structs import replace

from helpers.made_scores import whole_score
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.records import (
    FindingKind,
    FindingRecord,
    InputFile,
    MethodKind,
    MethodRecord,
    Provenance,
)
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.report.page import render_page
from sfr_loc_map.report.summary import banner_of, look_first, restrictions_of, run_facts

FAIL, PASS = VerdictState.FAIL, VerdictState.PASS


def named(truth: str = "drives/crater/loc/groundtruth.csv", **settings: object) -> Score:
    made = Provenance(
        version="9.9",
        inputs={"estimate": InputFile(path="out/e.csv", sha256="0"), "truth": InputFile(path=truth, sha256="0")},
        configuration={"trajectory.spacing": 10, "trajectory.conditions": ["distance=5"], **settings},
        host={"machine": "x86_64", "python": "3.11"},
        time="2024-02-29T12:00:00+00:00",
    )
    method = MethodRecord(name="orbslam", version="3", kind=MethodKind.PYTHON)
    return replace(whole_score(), provenance=made, method=method)


def verdict(value: float | None, limit: float, state: VerdictState, name: str = "position_mean_m") -> Verdict:
    figure = name.partition("_")[0]
    return Verdict(
        name=name, figure=figure, statistic="mean", limit=limit, value=value, state=state, n=7, condition="distance=5"
    )


def test_missed_limits_come_first_the_worst_before_the_others() -> None:
    failed = [verdict(value, 0.1, FAIL) for value in (0.12, 1.1, 2.0)]
    met = [verdict(value, 0.1, PASS, "heading_mean_deg") for value in (0.01, -0.09)]
    undecided = verdict(None, 0.1, VerdictState.NOT_ENOUGH_DATA)
    shown = look_first(Score(verdicts=(*met, *failed, undecided)))
    assert [item.why for item in shown] == [
        "The limit is missed: 2 m, limit ≤ 0.1 m.",
        "The limit is missed: 1.1 m, limit ≤ 0.1 m.",
        "The limit is missed: 120 mm, limit ≤ 100 mm.",
        "There is not enough data to judge this limit: no data.",
        "This limit is met with the smallest margin: -0.09 deg, limit ≤ 0.1 deg.",
    ]
    assert shown[0].what == "position error over 5 m, mean"
    (item,) = look_first(Score(verdicts=(verdict(0.4, 0.8, FAIL, "coverage_min"),)))
    assert item.why == "The limit is missed: 40 %, limit ≥ 80 %."


def test_limits_of_zero_follow_those_with_a_ratio_and_one_cause_is_one_item() -> None:
    failed = [verdict(0.01, 0.0, FAIL, "attitude_mean_deg"), verdict(900.0, 0.1, FAIL)]
    undecided = [
        verdict(None, 0.1, VerdictState.NOT_ENOUGH_DATA, name) for name in ("coverage_min", "heading_mean_deg")
    ]
    far, zero, open_limits = look_first(Score(verdicts=(*failed, *undecided)))
    assert "900 m" in far.why
    assert "0.01 deg" in zero.why
    assert open_limits.why == "There is not enough data to judge these 2 limits: no data."


def test_the_banner_states_a_contradiction_beside_a_failed_method() -> None:
    limits = parse_limits({"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 1.0}]}, "test")
    crash = FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=None, text="signal 11")
    score = judged_by(replace(whole_score(), contradiction="its quaternions are conjugated"), limits)
    assert banner_of(score).text == "Not judged: its quaternions are conjugated."
    failed = banner_of(judged_by(replace(score, findings=(crash,)), limits))
    assert failed.state == "fail"
    assert failed.text == "The method under test failed: crashed. Not judged: its quaternions are conjugated."


def test_the_page_states_each_warning_once_and_a_contradiction_in_the_banner_alone() -> None:
    wrong, warning = "its quaternions are conjugated", "the truth is <noisy>"
    score = replace(whole_score(), contradiction=wrong, warnings=(wrong, warning), caveats=(warning,))
    assert restrictions_of(score) == (warning,)
    page = render_page(score, plots=False)
    assert page.count("<li>the truth is &lt;noisy&gt;</li>") == 1
    assert page.count(wrong) == 1
    assert 'id="warnings"' not in render_page(replace(score, warnings=(), caveats=()), plots=False)


def test_the_header_counts_poses_if_the_images_are_unknown() -> None:
    score = named()
    assert score.association is not None
    texts = {
        images: dict(run_facts(replace(score, association=replace(score.association, images=images))))["Drive"]
        for images in (None, 300)
    }
    assert "poses with a truth" in texts[None]
    assert "stereo pairs with a truth" in texts[300]
