"""Limits of a file: verdicts on figures, each found by its name, and files that are refused."""

from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from helpers.random_drives import as_score, drive, score_of, trajectory
from helpers.score_rows import complete
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.metrics.calls.call_score import score_target
from sfr_loc_map.metrics.calls.calls import Calls
from sfr_loc_map.metrics.completeness.expected_items import answers_completeness
from sfr_loc_map.metrics.completeness.shortfall_kinds import SHORTFALLS, UNKNOWN_ITEMS, ShortfallKind
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.records import AnswerCounts, Association, ExternalScore, FindingKind, FindingRecord
from sfr_loc_map.metrics.figures.row_part import RowPart
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.figures.subjects import LimitSection
from sfr_loc_map.metrics.formulas import QUANTILES
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.judging.incomplete import Shortfall, statistic_of
from sfr_loc_map.metrics.judging.judge import judged_by, overall_verdict, with_verdicts
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.judging.reasons import reasons_not_judged
from sfr_loc_map.metrics.score.limits import BOUND, LIMITED_NUMBERS, Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.file_check import fault_of_verdicts
from sfr_loc_map.metrics.stored.score_json import from_dict, from_json, to_dict, to_json
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.report.verdict_view import unit_of
from sfr_loc_map.suite_names import Task

LIMIT = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.5}]}


def judge(content: dict[str, Any], score: Score) -> list[str]:
    return [item.state for item in judged_by(score, parse_limits(content, "limits")).verdicts]


def with_position(total: float | None, interval: tuple[float, float] | None = None, count: int = 20) -> Score:
    """A score of two conditions whose position over 5 m has a mean + 3 sigma, and whose heading is 0.6 deg off."""
    truth, estimate = drive(1)
    score = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("time=3", "distance=5")))
    low, high = interval or (None, None)
    figures = []
    for row in score.figures:
        if (row.condition, row.part, row.figure) == ("distance=5", "pose", "position"):
            row = replace(row, mean_plus_3sigma=total, low95=low, high95=high, n=count)
        elif (row.condition, row.part, row.figure) == ("distance=5", "pose", "heading"):
            row = replace(row, mean=-0.6, n=count)
        figures.append(row)
    return replace(score, figures=tuple(figures))


def test_pass_fail_and_not_enough_data() -> None:
    assert [judge(LIMIT, with_position(total))[0] for total in (0.4, 0.5, 0.6)] == ["pass", "pass", "fail"]
    assert judge(LIMIT, with_position(None, count=1)) == ["not enough data"]
    assert judge({**LIMIT, "minimum_count": 30}, with_position(0.6)) == ["not enough data"]
    assert judge({**LIMIT, "minimum_count": 20}, with_position(0.4)) == ["pass"], "as many as are required"
    assert judge(LIMIT, Score()) == ["not enough data"]
    signed = {"trajectory": [{"condition": "distance=5", "heading_mean_deg": 0.5}]}
    assert judge(signed, with_position(0.4)) == ["fail"], "a signed mean is judged by its size"
    verdict = judged_by(with_position(0.4, (0.3, 0.7)), parse_limits(LIMIT, "limits")).verdicts[0]
    assert (verdict.state, verdict.certain, verdict.interval) == ("pass", False, (0.3, 0.7))
    where = (verdict.subject, verdict.condition, verdict.part, verdict.figure, verdict.statistic)
    assert where == ("trajectory", "distance=5", "pose", "position", "mean_plus_3sigma")
    assert verdict.margin == pytest.approx(0.1)
    barely = with_position(0.5005)
    assert judge(LIMIT, barely) == ["fail"], "a thousandth above the limit"


def test_coverage_is_a_lower_bound_and_times_have_counts() -> None:
    content = {"map": {"coverage_min": 0.8}, "timing": {"localisation_p95_s": 0.1}, "memory": {"mapping_peak_bytes": 9}}
    score = Score(
        figures=(
            figure_row("coverage", n=2, value=0.9),
            figure_row("localisation", n=1, p95=0.5),
            figure_row("peak", part="mapping", n=1, value=10),
            *complete(),
        )
    )
    assert judge(content, score) == ["pass", "not enough data", "fail"]
    assert judge({"map": {"coverage_min": 0.95}}, score) == ["fail"]
    assert [item.name for item in judged_by(score, parse_limits(content, "limits")).missed] == ["mapping_peak_bytes"]


@pytest.mark.clause("4.2.1")
def test_the_target_is_judged_by_its_own_figures() -> None:
    unknown = np.full(2, np.nan)
    calls = Calls(np.arange(2), np.array([0.5, 0.7]), ["", ""], unknown, unknown)
    figures, target = score_target(calls, "GR740", {Task.LOCALISATION: calls.stamps_ns}, has_stamps=True)
    score = Score(figures=(*figures, *complete()), target=target)
    content = {"target": {"localisation_max_s": 0.6, "localisation_peak_bytes": 5}, "timing": {"localisation_max_s": 1}}
    got = judged_by(score, parse_limits(content, "limits")).verdicts
    assert [(item.name, item.state, item.value) for item in got] == [
        ("localisation_max_s", "not enough data", None),
        ("target localisation_max_s", "fail", 0.7),
        ("target localisation_peak_bytes", "not enough data", None),
    ]


def test_each_name_of_a_limit_finds_its_number() -> None:
    """Every row that the catalogue can name is found by exactly its own value, and a verdict names its limit again."""
    for part, names in LIMITED_NUMBERS.items():
        for name, limited in names.items():
            statistic = limited.statistic
            if statistic == BOUND:  # of a table of errors, not of a column: test_tolerance.py
                continue
            row = figure_row(
                limited.figure,
                "distance=5" if part is LimitSection.TRAJECTORY else None,
                "pose" if part is LimitSection.TRAJECTORY else limited.part,
                n=50,
                **{statistic: 0.25},
            )
            entry = {name: 0.5}
            content = {str(part): [{"condition": "distance=5", **entry}] if part is LimitSection.TRAJECTORY else entry}
            limits = parse_limits(content, "limits")
            of_poses = Association(matched=50, estimate_poses=50, truth_poses=50)
            score = judged_by(Score(figures=(row, *complete()), association=of_poses), limits)
            verdict = score.verdicts[-1]
            assert verdict.value == 0.25, name
            assert (verdict.figure, verdict.statistic) == (limited.figure, statistic)
            assert score.rules == Limits(limits=limits.limits)


def test_the_verdict_over_all() -> None:
    limits = parse_limits(LIMIT, "limits")
    good, bad, unknown = (judged_by(with_position(total), limits) for total in (0.4, 0.6, None))
    assert [item.verdict for item in (good, bad, unknown)] == ["pass", "fail", "not enough data"]
    assert judged_by(with_position(0.4), None).verdict is None
    half = figure_row("missing", n=2, value=0.5)
    for total, verdict in ((0.4, "incomplete"), (0.6, "fail")):
        whole = with_position(total)
        rows = [half if (row.figure, row.part) == ("missing", None) else row for row in whole.figures]
        part = judged_by(replace(whole, figures=tuple(rows)), limits)
        assert part.verdict == verdict
        assert part.verdicts[0].name == "missing_max_share"
    assert overall_verdict(replace(good, contradiction="its quaternions are conjugated"), ["pass"], None) is None
    crash = FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=None, text="signal 11")
    assert judged_by(replace(with_position(0.4), findings=(crash,)), limits).verdict == "fail"
    assert overall_verdict(Score(findings=(crash,)), [], None) == "fail"
    late = replace(crash, kind=FindingKind.LATE)
    assert judged_by(replace(with_position(0.4), findings=(late,)), limits).verdict == "pass"


def test_reasons_why_something_is_not_judged() -> None:
    truth, estimate = drive(1)
    score = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("distance=5", "distance=1000001")))
    assert len(reasons_not_judged(score)) == 1
    assert "distance=1000001" in reasons_not_judged(score)[0]
    few = judged_by(with_position(None, count=1), parse_limits(LIMIT, "limits"))
    assert "too few values: 1" in reasons_not_judged(few)[0]


def test_what_a_limit_says_of_itself_counts_before_what_its_block_says() -> None:
    block = {"id": "A", "coverage_min": {"limit": 0.8, "id": "B"}, "point_error_p95_m": 1}
    limits = parse_limits({"minimum_independent": 3, "map": block}, "limits")
    assert [item.id for item in limits.limits] == ["B", "A"]
    assert limits.minimum_independent == 3
    assert parse_limits({"map": block}, "limits").minimum_independent == 5, "as docs/metrics.md says"


@pytest.mark.parametrize(
    "blocks",
    [
        [{"coverage_min": 0.8, "id": "A"}, {"coverage_min": 0.9, "id": "B"}],
        [{"coverage_min": 0.8}, {"coverage_min": 0.8}],
        [{"coverage_min": 0.8}, {"point_error_p95_m": 0.8}],
    ],
)
def test_several_requirements_may_limit_one_number(blocks: list[dict[str, Any]]) -> None:
    assert len(parse_limits({"map": blocks}, "limits").limits) == 2


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"trajectry": []}, "did you mean 'trajectory'"),
        ({"trajectory": [{"condition": "distance=5", "position_mean_mm": 5}]}, "position_mean_m"),
        ({"trajectory": [{"position_mean_m": 5}]}, "'condition', such as"),
        (
            {"trajectory": [{"condition": "distance=5", "position_mean_m": 5}, {"condition": "distance=10"}]},
            "entry 2: the condition distance=10 has no limit",
        ),
        ({"map": {"coverage_min": float("nan")}}, "a number >= 0"),
        ({"map": {"point_error_p95_m": float("inf")}}, "a number >= 0"),
        ({"completeness": {"missing_max_share": 5}}, "a fraction from 0 to 1"),
        ({"map": {"coverage_min": 95}}, "a fraction from 0 to 1"),
        ({"minimum_independent": 0.5, "map": {"coverage_min": 0.8}}, "minimum_independent"),
        ({"map": [1]}, "limits as NAME: NUMBER"),
        (
            {"trajectory": [{"condition": "distance=5", "position_bound_m": {"limit": 9, "certain": True}}]},
            "'position_bound_m': 'certain' is not accepted",
        ),
        (
            {"trajectory": [{"condition": "distance=5", "position_mean_m": {"limit": 9, "certain": True}}]},
            "'position_mean_m': 'certain' requires a 95 % interval",
        ),
        ({"map": {"certain": True, "point_error_mean_plus_3sigma_m": 9}}, "'certain' requires a 95 % interval"),
        (
            {"trajectory": [{"condition": "distance=5", "position_bound_m": {"limit": 9, "power": 0.8}}]},
            "'position_bound_m': 'power' is the power of the sequential test",
        ),
        (
            {"trajectory": [{"condition": "distance=5", "position_bound_m": {"limit": 9, "prob": 1}}]},
            "'position_bound_m': 'prob' is 1: a number from 0.5",
        ),
        ({"minimum_count": 1, "map": {"coverage_min": 0.8}}, "minimum_count"),
        ({"minimum_count": 10**400, "map": {"coverage_min": 0.8}}, "minimum_count"),
        ({"minimum_independent": 10**400, "map": {"coverage_min": 0.8}}, "minimum_independent"),
        ({"map": {"point_error_mean_m": 10**400}}, "'point_error_mean_m' is an integer above"),
        ({"map": {"coverage_min": 16**5000}}, "'coverage_min' is an integer above"),
        (
            {"map": [{"coverage_min": 0.8}, {"coverage_min": 0.9}]},
            "'coverage_min' has two different limits, 0.8 and 0.9",
        ),
        (
            {"map": {"points_repeated_max_share": 0.1}, "completeness": {"points_repeated_max_share": 0}},
            "two different",
        ),
        (
            {
                "trajectory": [
                    {"condition": text, "position_mean_m": n} for n, text in enumerate(("time=5", "time=5 s"))
                ]
            },
            "'position_mean_m' over time=5 has two different limits, 0 and 1",
        ),
        ({"data_set_sha256": "0" * 64, "map": {"coverage_min": 0.8}}, "a list of SHA-256"),
        ({"data_set_sha256": [], "map": {"coverage_min": 0.8}}, "a list of SHA-256"),
        ({"data_set_sha256": ["12ab"], "map": {"coverage_min": 0.8}}, "contains .12ab."),
        ({"data_set_sha256": [10**63], "map": {"coverage_min": 0.8}}, "64 hexadecimal digits"),
        ({}, "no limit"),
    ],
)
def test_malformed_limits_are_refused_in_one_line(content: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        parse_limits(content, "limits.yaml")
    assert "\n" not in str(caught.value)


def test_certainty_of_a_block_does_not_apply_to_its_tolerance_bounds() -> None:
    block = {"condition": "distance=5", "certain": True, "position_mean_plus_3sigma_m": 1, "position_bound_m": 1}
    limits = parse_limits({"trajectory": [block]}, "limits")
    assert [item.certain for item in limits.limits] == [True, False]
    with pytest.raises(ValueError, match="'certain' is not accepted"):
        replace(limits.limits[1], certain=True)


@pytest.mark.parametrize(
    ("terms", "name", "other"),
    [
        ({"prob": 0.99999999}, "prob", 0.999999995),
        ({"confidence": 0.9}, "confidence", 0.90000001),
        ({}, "normal", True),
        ({"interpretation": "ensemble"}, "interpretation", "mixed"),
        ({"prob": 0.9, "interpretation": "ensemble", "good": 0.001}, "good", 0.00100000001),
        ({"prob": 0.9, "interpretation": "ensemble", "good": 0.001}, "power", 0.90000001),
    ],
)
def test_bounds_by_other_terms_are_other_rows(terms: dict[str, Any], name: str, other: object) -> None:
    entries = [
        {"condition": "distance=5", "position_bound_m": {"limit": 1, **each}} for each in (terms, terms | {name: other})
    ]
    score = judged_by(with_position(0.4), parse_limits({"trajectory": entries}, "limits"))
    assert len({row.keys for row in score.figures if row.figure == BOUND}) == 2


def bounded() -> Limits:
    entry = {"limit": 0.5, "prob": 0.8, "confidence": 0.8}
    bounds = {"position_bound_m": entry, "chord_bound_m": entry}
    return parse_limits({"trajectory": [{"condition": "distance=5", **bounds}]}, "limits")


def test_a_bound_on_horizontal_errors_judges_a_truth_without_heights(monkeypatch: pytest.MonkeyPatch) -> None:
    """The errors are kept, even where plots have few of them."""
    entry = {"limit": 0.5, "prob": 0.8, "confidence": 0.8}
    content = {"trajectory": [{"condition": "distance=5", "horizontal_bound_m": entry}], "minimum_independent": 1}
    limits, config = parse_limits(content, "limits"), TrajectoryScoreConfig(conditions=("distance=5",), spacing=1)
    true, estimate = (trajectory(poses) for poses in drive(1, count=400))
    truth = Truth(true.stamps_ns, true.positions, true.quats_xyzw, has_height=False)
    found = []
    for most in (100_000, 100):
        monkeypatch.setattr("sfr_loc_map.metrics.trajectory.plot_columns.DETAIL_ROWS", most)
        scored = score_trajectory(Estimates.of(estimate), truth, config, kept_errors=limits.bounded_figures)
        found.append(judged_by(as_score(scored), limits))
    bounds = [score.on_limits[0].value for score in found]
    assert bounds[0] is not None
    assert bounds[0] == bounds[1]
    for score in found:
        assert fault_of_verdicts(score, with_verdicts(score)) is None
        without_errors = replace(score, errors=())
        assert fault_of_verdicts(score, with_verdicts(without_errors)) is not None


def test_the_errors_of_figures_with_a_limited_bound_are_kept() -> None:
    entry = {"limit": 0.5, "prob": 0.8, "confidence": 0.8}
    content = {
        "trajectory": [{"condition": "distance=5", "position_bound_m": entry, "chord_p95_m": 1.0}],
        "timing": {"localisation_max_s": 1.0},
    }
    assert parse_limits(content, "limits").bounded_figures == {("position", "distance=5")}


def test_a_limit_on_horizontal_errors_is_judged_by_each_reading() -> None:
    """The axes of the estimate are not those of the truth, which only the reading `pose` removes."""
    true, estimate = (trajectory(poses) for poses in drive(1, count=400))
    truth = Truth(true.stamps_ns, true.positions, true.quats_xyzw, has_height=False)
    scored = score_trajectory(Estimates.of(estimate), truth, TrajectoryScoreConfig(conditions=("distance=5",)))
    score = Score(figures=scored.figures, association=scored.association, truth=scored.truth)
    readings = {row.part: row.mean_plus_3sigma for row in score.rows("horizontal", condition="distance=5")}
    assert readings["pose"] is not None
    assert readings["position"] == readings["displacement"] > 2.0 * readings["pose"]
    assert score.number("horizontal", "mean", condition=None, part="5 m") is not None, (
        "over a distance travelled as well"
    )
    content = {"trajectory": [{"condition": "distance=5", "horizontal_mean_plus_3sigma_m": 1.5 * readings["pose"]}]}
    (verdict,) = judged_by(score, parse_limits({**content, "minimum_independent": 1}, "limits")).on_limits
    assert verdict.by_reading == {"pose": "pass", "displacement": "fail", "position": "fail"}


@pytest.mark.parametrize(
    ("name", "changed", "words"),
    [
        ("position_bound_m", {"prob": 0.3}, "'prob' is 0.3: a number from 0.5 to below 1 is required"),
        ("position_bound_m", {"prob": None}, "the limit requires prob"),
        ("position_bound_m", {"good": 0.001}, "the interpretation ensemble or mixed is required"),
        ("position_mean_m", {"prob": 0.9}, "only a tolerance bound has them"),
        ("position_mean_m", {"condition": None}, "has no condition"),
    ],
)
def test_the_terms_of_a_stored_limit_are_checked_as_in_a_limits_file(
    name: str, changed: dict[str, Any], words: str
) -> None:
    limits = parse_limits({"trajectory": [{"condition": "distance=5", name: {"limit": 0.5}}]}, "limits")
    stored = to_dict(judged_by(with_position(0.4), limits))
    stored["rules"]["limits"][0] |= changed
    with pytest.raises(InputError, match=words) as caught:
        from_dict(stored)
    assert "\n" not in str(caught.value)


def test_a_new_quantile_changes_no_verdict_on_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = {"limit": 0.5, "prob": 0.9973, "confidence": 0.8}
    (limit,) = parse_limits({"trajectory": [{"condition": "distance=5", "position_bound_m": entry}]}, "limits").limits
    assert statistic_of(limit) == "p99"
    for quantiles in ({**QUANTILES, "p997": 99.7}, {"p997": 99.7, **QUANTILES}):
        monkeypatch.setattr("sfr_loc_map.metrics.judging.incomplete.QUANTILES", quantiles)
        assert statistic_of(limit) == "p99"
    assert [statistic_of(replace(limit, prob=prob)) for prob in (0.5, 0.94, 0.95)] == ["p50", "p50", "p95"]


def test_a_bound_is_made_of_all_errors_with_plots_and_without(monkeypatch: pytest.MonkeyPatch) -> None:
    """The details for plots are thinned, or are left out as in a live report; no verdict depends on that."""
    limits, config = bounded(), TrajectoryScoreConfig(conditions=("distance=5",), spacing=1)
    truth, estimate = (trajectory(poses) for poses in drive(1, count=400))
    made = []
    for most, details in ((100_000, True), (100, True), (100, False)):
        monkeypatch.setattr("sfr_loc_map.metrics.trajectory.plot_columns.DETAIL_ROWS", most)
        scored = score_trajectory(
            Estimates.of(estimate), truth, config, details=details, kept_errors=limits.bounded_figures
        )
        made.append(judged_by(as_score(scored), limits))
    thinned = made[1].details
    assert thinned is not None
    assert thinned.trajectory is not None
    assert thinned.trajectory.sub_trajectories[0].every > 1
    for several in zip(*(score.verdicts for score in made), strict=True):
        assert several[0].value is not None
        assert several[0] == several[1] == several[2]
    assert from_json(to_json(made[1])) == made[1]
    plots_only = judged_by(replace(made[0], errors=()), limits)
    assert {item.value for item in plots_only.on_limits} == {None}, "plots are rounded"


def test_a_verdict_on_what_contradicts_is_not_judged_but_a_crash_has_failed() -> None:
    limits = parse_limits(LIMIT, "limits")
    crash = FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=None, text="signal 11")
    score = replace(with_position(0.6), contradiction="its quaternions are conjugated", findings=(crash,))
    assert [item.state for item in judged_by(score, limits).verdicts] == ["fail", "not judged"]
    assert judged_by(score, limits).verdict == "fail"
    assert judged_by(replace(score, findings=()), limits).verdict is None


def test_a_verdict_is_certain_where_the_interval_is_on_one_side_of_the_limit() -> None:
    for interval, total, state, certain in (
        ((0.3, 0.49), 0.4, "pass", True),
        ((0.3, 0.5), 0.4, "pass", True),  # an interval that ends at the limit meets it
        ((0.3, 0.51), 0.4, "pass", False),
        ((0.5, 0.7), 0.6, "fail", False),
        ((0.51, 0.7), 0.6, "fail", True),
        ((0.51, 0.7), 0.49, "pass", False),  # the interval of a small sample need not contain the value
        ((0.3, 0.49), 0.51, "fail", False),
    ):
        (verdict,) = judged_by(with_position(total, interval), parse_limits(LIMIT, "limits")).on_limits
        assert (verdict.state, verdict.certain) == (state, certain), interval


def test_an_interval_beyond_the_limit_is_no_certain_pass() -> None:
    entry = {"condition": "distance=5", "position_mean_plus_3sigma_m": 0.5, "certain": True}
    (verdict,) = judged_by(with_position(0.49, (0.51, 0.7)), parse_limits({"trajectory": [entry]}, "limits")).on_limits
    assert (verdict.state, verdict.certain) == ("not enough data", False)


def test_an_absent_answer_leaves_no_pass_beside_absent_calls() -> None:
    """The shortfall of the calls does not replace the gap of the drive."""
    answers = AnswerCounts(pairs=20, missing=1)
    node = ExternalScore(task="localisation", topic="t", frames="odom", answers=answers, latency_s=None)
    score = with_position(0.4)
    score = replace(score, figures=(*score.figures, *answers_completeness(node)), external=node)
    rules = {**LIMIT, "timing": {"localisation_max_s": 1.0}}
    made = judged_by(score, parse_limits(rules, "limits"))
    assert [item.state for item in made.on_limits] == ["incomplete", "not enough data"]
    assert made.incomplete is not None
    assert "5 % of the pairs have no answer" in made.incomplete
    allowed = {**rules, "completeness": {"missing_max_share": 0.1}}
    assert judged_by(score, parse_limits(allowed, "limits")).on_limits[0].state == "pass"


def test_the_margin_of_what_is_missed_is_negative() -> None:
    restarts_kind = next(kind for kind in SHORTFALLS if kind.figure == "restarts")
    short = Shortfall(UNKNOWN_ITEMS, RowPart("drive"), 1.0, 0.8, "").verdict
    assert (short.name, short.margin, short.is_lower_bound) == ("judged", pytest.approx(-0.2), True)
    restarts = Shortfall(restarts_kind, RowPart("live"), 0.0, 3.0, "").verdict
    assert (restarts.name, restarts.margin, unit_of(restarts).symbol) == ("restarts", -3.0, "")


@pytest.mark.parametrize("kind", SHORTFALLS)
def test_a_shortfall_has_the_name_of_a_limit_only_if_a_limits_file_accepts_the_limit(kind: ShortfallKind) -> None:
    assert (kind.limit_name in LIMITED_NUMBERS[LimitSection.COMPLETENESS]) == kind.is_limited


def test_an_unknown_fraction_of_calls_is_the_worst() -> None:
    limits = parse_limits({"completeness": {"calls_other_max_share": 0.1}}, "limits")
    values = {"mapping": 0.0, "fusion": None}
    rows = tuple(figure_row("calls_other", part=kind, n=5, value=value) for kind, value in values.items())
    assert [item.state for item in judged_by(Score(figures=rows), limits).verdicts] == ["not enough data"]


def test_as_many_independent_sub_trajectories_as_are_required_are_enough() -> None:
    for independent, state in ((5.0, "pass"), (4.9, "not enough data")):
        score = with_position(0.4)
        rows = [
            replace(row, independent=independent) if row.figure == "position" and row.condition == "distance=5" else row
            for row in score.figures
        ]
        assert judge(LIMIT, replace(score, figures=tuple(rows))) == [state]


def test_a_fraction_of_no_items_meets_its_limit_unless_items_are_required() -> None:
    rules = {"completeness": {"poses_of_truth_max_share": 1.0, "calls_other_max_share": 0.1}}
    rows = (
        figure_row("poses_of_truth", n=0),
        figure_row("calls_other", part="fusion", n=0),
        figure_row("calls_other", part="mapping", n=5, value=0.05),
    )
    score = judged_by(Score(figures=rows), parse_limits(rules, "limits"))
    assert [(item.state, item.value) for item in score.verdicts] == [("pass", None), ("pass", 0.05)]
    bare = (figure_row("pixels_without_point", n=0),)
    required = parse_limits({"completeness": {"pixels_without_point_max_share": 1.0}}, "limits")
    assert judged_by(Score(figures=bare), required).verdicts[-1].state == "not enough data"


def test_a_limit_on_the_target_without_its_calls_names_the_option_that_gives_them() -> None:
    limits = parse_limits({"target": {"localisation_p95_s": 1.0}}, "limits")
    rows = (figure_row("judged", part="drive", n=2, value=1.0),)
    incomplete = judged_by(Score(figures=rows), limits).incomplete or ""
    assert "localisation calls on the target" in incomplete
    assert "option target_timing" in incomplete
