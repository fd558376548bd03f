"""Time and memory of calls: measured one by one, by hand, told apart by kind, under the name of their clock."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.calls.call_record import usage_of_stages
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.calls import call_meter
from sfr_loc_map.metrics.calls.call_meter import HOST_CLOCK, METHOD_UNAVAILABLE, CallMeter, CallUsage
from sfr_loc_map.metrics.calls.call_score import STATED_BY_NODE, Measurement, score_calls, score_target, with_external
from sfr_loc_map.metrics.calls.calls import KNOWN_STATES, Calls, stage_of
from sfr_loc_map.metrics.completeness.expected_items import answers_completeness, calls_completeness
from sfr_loc_map.metrics.config import CallKind, MappingState
from sfr_loc_map.metrics.figures.records import AnswerCounts, ExternalScore, ProcessUsage
from sfr_loc_map.metrics.figures.row_part import AFTER_FIRST, FIRST, Place, RowPart
from sfr_loc_map.metrics.figures.subjects import Scope, Subject
from sfr_loc_map.metrics.formulas import Statistics, memory_above_idle
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.suite_names import Task

SIZE = 200 * 1024 * 1024
STATED = dict.fromkeys(CallKind, Measurement(Place.STATED, STATED_BY_NODE))


@pytest.mark.clause("4.2.2")
def test_a_known_allocation_is_measured_and_that_of_an_earlier_call_is_not() -> None:
    meter = CallMeter()
    if meter.method == METHOD_UNAVAILABLE:
        pytest.skip(METHOD_UNAVAILABLE)
    with meter.measure() as call:
        np.ones(SIZE, np.uint8)
    assert call.above_idle_bytes == pytest.approx(SIZE, rel=0.01)
    assert (call.peak_rss_bytes or 0) > SIZE
    with meter.measure() as call:
        pass
    assert (call.above_idle_bytes or 0) < 0.05 * SIZE


@pytest.mark.clause("4.2.2")
def test_memory_above_an_idle_memory_that_the_process_no_longer_has_is_unknown() -> None:
    held = np.ones(SIZE, np.uint8)
    meter = CallMeter()
    if meter.method == METHOD_UNAVAILABLE:
        pytest.skip(METHOD_UNAVAILABLE)
    del held
    with meter.measure() as call:
        pass
    assert call.peak_rss_bytes is not None
    assert call.above_idle_bytes is None
    assert memory_above_idle(5, 5) == 0


@pytest.mark.clause("4.3.2")
def test_memory_of_a_mapping_call_above_the_idle_process_is_unknown_if_it_is_unknown_for_a_stage() -> None:
    known, unknown, unmeasured = CallUsage(1.0, 10, 5), CallUsage(1.0, 20), CallUsage(1.0)
    assert usage_of_stages([known, unmeasured]) == CallUsage(2.0, 10, 5)
    assert usage_of_stages([known, unknown]) == CallUsage(2.0, 20)


@pytest.mark.clause("4.2.1", "4.2.2")
def test_a_clock_can_be_plugged_in_an_error_passes_and_memory_may_be_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_meter, "reset_peak", lambda process: None)
    ticks = iter([1_000, 2_500_001_000])
    meter = CallMeter(lambda: next(ticks), "test clock")
    with pytest.raises(ValueError, match="inside"), meter.measure() as call:
        raise ValueError("inside")
    assert call.processing_time_s == pytest.approx(2.5)
    assert (meter.clock, meter.method) == ("test clock", METHOD_UNAVAILABLE)
    assert (call.peak_rss_bytes, call.above_idle_bytes) == (None, None)


def calls(
    states: list[str], seconds: list[float] | np.ndarray, peak: list[float] | None = None, **stages: list[float]
) -> Calls:
    """Calls; memory is not measured unless it is given."""
    peaks = np.full(len(states), np.nan) if peak is None else np.array(peak)
    named = {name: np.array(values) for name, values in stages.items()}
    return Calls(np.arange(len(states)), np.array(seconds), states, peaks, peaks / 10.0, named)


@pytest.mark.parametrize(("failing", "is_peak_known"), [("mark_idle", True), ("measure", False)])
def test_memory_is_unknown_if_the_mark_cannot_be_reset(
    monkeypatch: pytest.MonkeyPatch, failing: str, *, is_peak_known: bool
) -> None:
    """Memory that is not known is null, never the complete resident memory or the peak of an earlier call."""
    meter = CallMeter()
    if meter.method == METHOD_UNAVAILABLE:
        pytest.skip("this system has no resettable high-water mark")
    with monkeypatch.context() as patched:
        patched.setattr(call_meter, "reset_peak", lambda process: None)
        if failing == "mark_idle":
            meter.mark_idle()
            patched.undo()
        with meter.measure() as usage:
            pass
    assert (usage.peak_rss_bytes is not None) is is_peak_known
    assert usage.above_idle_bytes is None
    meter.mark_idle()
    with meter.measure() as usage:
        pass
    assert usage.above_idle_bytes is not None


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"seconds": np.ones(3)}, r"'seconds' of calls has the shape \(3,\)"),
        ({"seconds": np.array([0.1, -0.1])}, "'seconds' of a call is -0.1"),
        ({"states": ["tracking"]}, "2 calls have 1 states"),
        ({"peak_bytes": np.ones((2, 1))}, "'peak_bytes' of calls"),
        ({"above_idle_bytes": np.array([-1.0, np.nan])}, "'above_idle_bytes' of a call is -1"),
        ({"heap_bytes": np.ones(1)}, "'heap_bytes' of calls"),
        ({"stage_s": {"align": np.ones(3)}}, r"'stage_s\[align\]' of calls"),
        ({"stage_s": {"align": np.array([0.1, -2.0])}}, r"'stage_s\[align\]' of a call is -2"),
    ],
)
def test_calls_with_columns_of_other_lengths_or_negative_numbers_are_refused(
    columns: dict[str, Any], words: str
) -> None:
    with pytest.raises(MetricsError, match=words):
        replace(calls(["tracking", "lost"], [0.1, 0.2]), **columns)


def of(made: Calls) -> Score:
    scored = score_calls(made, {})
    return Score(figures=scored.figures, calls=scored.records)


@pytest.mark.clause("4.2.1")
def test_figures_by_hand() -> None:
    got = of(calls(["tracking"] * 5, [5.0, 1.0, 2.0, 3.0, np.nan]))
    row = got.figure("localisation", part=None)
    assert (row.clause, row.n, row.mean) == ("", 4, 2.75), "the document defines times on the target"
    assert got.calls.clocks == {"localisation": HOST_CLOCK}
    assert row.sigma == pytest.approx(np.sqrt(8.75 / 3))
    assert row.mean_plus_3sigma == pytest.approx(2.75 + 3 * np.sqrt(8.75 / 3))
    assert (row.p50, row.max) == (2.5, 5.0)
    assert row.p95 == pytest.approx(np.percentile([5.0, 1.0, 2.0, 3.0], 95))
    assert row.p99 == pytest.approx(np.percentile([5.0, 1.0, 2.0, 3.0], 99))
    assert got.number("localisation", part=FIRST) == 5.0
    assert got.number("localisation", "max", part=AFTER_FIRST) == 3.0
    assert not of(calls(["tracking"], [np.nan])).rows("localisation")


@pytest.mark.clause("4.2.1", "4.3.1", "4.2.2", "4.3.2")
def test_localisation_mapping_and_fusion_are_told_apart() -> None:
    states = ["initialising", "tracking", "mapped", "mapped", "fused"]
    got = of(calls(states, [1.0, 2.0, 3.0, 4.0, 5.0], [10.0, 30.0, 20.0, np.nan, 5.0]))
    assert (got.number("localisation", "mean"), got.number("mapping", "max")) == (1.5, 4.0)
    assert got.figure("fusion").n == 1
    assert [got.number(name, part="localisation") for name in ("peak", "above_idle")] == [30, 3]
    assert [got.number(name, part="mapping") for name in ("peak", "above_idle")] == [20, 2]
    unknown = of(calls(["tracking", "lost"], [1.0, 1.0]))
    assert [unknown.number(name, part="localisation") for name in ("peak", "above_idle")] == [None, None]
    assert unknown.figure("peak", part="mapping") is None
    zeros = of(calls(["tracking", "tracking"], [1.0, 1.0], [0.0, 5.0]))
    empty = of(calls(["tracking"], [1.0], [0.0]))
    assert zeros.number("peak", part="localisation") == 5
    assert empty.number("peak", part="localisation") is None, "a peak of no bytes was not measured"
    assert unknown.calls.memory_method == METHOD_UNAVAILABLE


@pytest.mark.parametrize("name", ["target", "target memory", "stated fusion", "localisation", "first call"])
def test_a_stage_is_no_call_on_the_target_whatever_its_name(name: str) -> None:
    """Names of stages come from files and nodes of users; a limit of the target must not find them."""
    stage = stage_of(f"stage_{name}_s")
    assert stage == f"'{name}'"
    assert stage is not None
    assert RowPart(stage).what == stage
    assert stage_of("stage_align_s") == "align"


def test_a_stage_is_over_the_calls_that_had_it() -> None:
    got = of(calls(["tracking"] * 3, [1.0, 2.0, 3.0], track=[0.5, np.nan, 1.5]))
    row = got.figure("localisation", part="track")
    assert (row.n, row.mean, row.max) == (2, 1.0, 1.5)


@pytest.mark.clause("4.2.1", "4.2.2")
def test_calls_of_a_target_are_apart_from_those_of_the_host() -> None:
    figures, target = score_target(calls([""], [1.0]), "GR740", {})
    assert [(row.part, row.clause) for row in figures if row.subject == Subject.TIMING] == [
        ("target", "4.2.1"),
        (f"target {FIRST}", ""),
    ]
    assert (target.name, target.memory_method) == ("GR740", None)
    measured, target = score_target(calls([""], [1.0], [7.0]), "GR740", {})
    assert Score(figures=measured).number("peak", part="target localisation") == 7.0
    assert target.memory_method == "as measured on GR740"


def test_calls_against_the_period_of_the_pairs() -> None:
    """Pairs every 0.1 s, one of them late; two of ten calls take longer."""
    stamps = np.arange(10) * 100_000_000
    stamps[9] += 300_000_000
    seconds = np.full(10, 0.05)
    seconds[[3, 7]] = 0.15
    unknown = np.full(10, np.nan)
    score = Score(figures=score_calls(Calls(stamps, seconds, ["tracking"] * 10, unknown, unknown), {}).figures)
    assert score.number("period", part="localisation") == pytest.approx(0.1)
    assert score.number("within_period", part="localisation") == pytest.approx(0.8)
    assert score.number("processor_share", part="localisation") == pytest.approx(0.7)
    without = score_calls(Calls(np.zeros(10, np.int64), seconds, ["tracking"] * 10, unknown, unknown), {})
    assert not Score(figures=without.figures).rows("period"), "calls without stamps have no period"


def test_the_method_of_memory_is_that_of_the_source_and_null_where_it_is_unknown() -> None:
    for method in (None, "sampled by the kit"):
        measured = replace(calls(["tracking"], [1.0], [7.0]), memory_method=method)
        assert score_calls(measured, {}).records.memory_method == method


def test_no_measured_call_has_no_fraction_of_other_stamps() -> None:
    stamps, unknown = np.arange(3) * 10**9, np.full(3, np.nan)
    rows = calls_completeness(CallKind.LOCALISATION, stamps, stamps, {Scope.CALLS: unknown})
    values = {row.figure: row.value for row in rows}
    assert values == {"judged": 0.0, "calls_missing": 1.0, "calls_other": None, "calls_doubled": None}


def test_a_call_that_takes_the_period_is_within_it_and_the_load_is_that_of_all_calls() -> None:
    stamps, unknown = np.array([0, 1, 2, 3, 9]) * 10**9, np.full(5, np.nan)
    seconds = np.array([1.0, 0.1, 0.1, 0.1, 2.7])
    score = Score(figures=score_calls(Calls(stamps, seconds, ["tracking"] * 5, unknown, unknown), {}).figures)
    assert score.number("period", part="localisation") == 1.0, "one pause does not change the period"
    assert score.number("within_period", part="localisation") == 0.8
    assert score.number("processor_share", part="localisation") == pytest.approx(0.8)


def test_the_share_of_a_target_is_of_the_estimates() -> None:
    stamps, unknown = np.array([0, 1]) * 10**9, np.full(2, np.nan)
    some = Calls(stamps, np.ones(2), ["tracking"] * 2, unknown, unknown)
    _, target = score_target(some, "GR740", {}, np.arange(4) * 10**9, has_stamps=True)
    assert target.matched_share == 0.5


def test_what_an_external_node_states_of_its_time_is_beside_what_was_measured() -> None:
    own = score_calls(calls(["tracking"] * 3, [0.001] * 3, [1e6] * 3), {}, STATED)
    late = Statistics(n=3, mean=0.4, p95=0.4)
    node = ExternalScore(task="localisation", topic="t", frames="odom", answers=AnswerCounts(), latency_s=late)
    score = Score(figures=with_external(own, node).figures)
    assert score.number("localisation", "p95", part=None) == 0.4
    assert score.number("localisation", "p95", part="stated") == 0.001


def test_no_kind_of_mapping_call_that_an_external_node_states_is_one_that_was_measured() -> None:
    """A node that says that its stage, its fusion and its mapping call took 1 ms and 1 MB."""
    states = ["mapped", "fused", "mapped_set"]
    answers = AnswerCounts(pairs=4, answered=3, missing=1, doubled=1, other_stamp=1)
    node = ExternalScore(task="mapping", topic="t", frames="map", answers=answers, latency_s=None)
    stated = score_calls(calls(states, [0.001] * 3, [1e6] * 3), {}, STATED)
    score = Score(figures=with_external(stated, node).figures)
    for kind in ("mapping", "fusion", "mapping_call"):
        assert score.judged_row(kind) is None
        assert score.figure("peak", part=kind) is None
        assert score.number("peak", part=f"stated {kind}") == 1e6
    assert not any(row.clause for row in score.figures if row.subject is not Subject.COMPLETENESS)
    found = [score.rows(name)[0].value for name in ("judged", "calls_missing", "calls_other", "calls_doubled")]
    assert found == [0.75, 0.25, 0.2, 0.2]


@pytest.mark.parametrize(("peak_bytes", "share"), [(10**6, 1.0), (0, 0.0)])
def test_a_peak_of_no_bytes_is_no_measured_memory_of_an_external_node(peak_bytes: int, share: float) -> None:
    usage = ProcessUsage(cpu_s=1.0, peak_rss_bytes=peak_bytes, processes=1, method="psutil")
    node = ExternalScore(
        task="mapping", topic="t", frames="map", answers=AnswerCounts(pairs=1), latency_s=None, process=usage
    )
    rows = Score(figures=tuple(answers_completeness(node)))
    assert rows.number("judged", part="memory mapping") == share
    assert rows.number("unmeasured", part="mapping") == 1.0 - share


@pytest.mark.parametrize("figure", ["peak_bytes", "above_idle_bytes", "heap_bytes", "stack_bytes"])
def test_memory_that_was_measured_in_some_calls_alone_is_incomplete(figure: str) -> None:
    stamps, memory = np.arange(10, dtype=np.int64), np.full(10, 1e6)
    whole = Calls(stamps, np.ones(10), ["tracking"] * 10, memory, memory, heap_bytes=memory, stack_bytes=memory)
    partial = replace(whole, **{figure: np.where(stamps < 3, memory, np.nan)})
    for calls, share in ((whole, 1.0), (partial, 0.3)):
        rows = score_calls(calls, {Task.LOCALISATION: stamps}).figures
        assert Score(figures=rows).number("judged", part=f"{Scope.MEMORY} localisation") == share


def test_a_misspelled_state_is_no_call_of_a_localiser() -> None:
    """The states are those of localiser and mapper, and a call may have no state."""
    assert {*KNOWN_STATES} == {"", *TrackingState, *MappingState}
    with pytest.raises(MetricsError, match="mapped_sett"):
        calls(["tracking", "mapped_sett"], [0.1, 0.2])


@pytest.mark.parametrize("value", [-1.0, float("inf"), -float("inf")])
@pytest.mark.parametrize("name", ["seconds", "peak_bytes", "above_idle_bytes", "heap_bytes", "stack_bytes", "stage_s"])
def test_a_number_of_a_call_that_is_negative_or_infinite_is_refused(name: str, value: float) -> None:
    columns = dict.fromkeys(("seconds", "peak_bytes", "above_idle_bytes"), np.ones(3))
    invalid = np.array([np.nan, value, 1.0])
    columns[name] = {"a": invalid} if name == "stage_s" else invalid
    with pytest.raises(MetricsError, match=f"'{name}.* of a call is {value:g}: a finite number"):
        Calls(stamps_ns=np.arange(3), states=["tracking"] * 3, **columns)
