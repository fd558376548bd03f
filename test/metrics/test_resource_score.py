import numpy as np
import pytest

from sfr_loc_map.metrics.calls.resource_score import Calls, ScoredCalls, score_calls, score_target, stage_of
from sfr_loc_map.metrics.modes import CallKind
from sfr_loc_map.metrics.score import MemoryScore, PeakMemory


@pytest.mark.clause("4.2.1", "4.3.1", "4.2.2", "4.3.2")
def test_localisation_mapping_and_fusion_are_told_apart() -> None:
    calls = Calls(
        np.arange(5),
        np.array([1.0, 2.0, 3.0, 4.0, 5.0]),
        ["initialising", "tracking", "mapped", "mapped", "fused"],
        np.array([10.0, 30.0, 20.0, np.nan, 5.0]),
        np.array([1.0, 3.0, 2.0, np.nan, 0.0]),
    )
    got = score_calls(calls)
    timing, memory = dict(got.timing.kinds()), got.memory
    assert timing[CallKind.LOCALISATION].mean == 1.5
    assert timing[CallKind.MAPPING].max == 4.0
    assert timing[CallKind.FUSION].count == 1
    assert memory.localisation == PeakMemory(peak_bytes=30, above_idle_bytes=3)
    assert memory.mapping == PeakMemory(peak_bytes=20, above_idle_bytes=2)
    assert timing[CallKind.MAPPING].clock == "host monotonic"


def test_unknown_memory_is_undefined_and_said() -> None:
    nothing = np.full(2, np.nan)
    got = score_calls(Calls(np.arange(2), np.ones(2), ["tracking", "lost"], nothing, nothing)).memory
    assert got.localisation == PeakMemory(peak_bytes=None, above_idle_bytes=None)
    assert got.mapping is None
    assert got.method is not None
    assert got.method.startswith("not measured")


def test_stages_are_summed_up_over_the_calls_that_had_them() -> None:
    nothing = np.full(4, np.nan)
    stages = {"align": np.array([1.0, 3.0, np.nan, 100.0]), "never": nothing}
    states = ["tracking", "tracking", "lost", "mapped"]
    timing = dict(score_calls(Calls(np.arange(4), np.ones(4), states, nothing, nothing, stages)).timing.kinds())
    found = timing[CallKind.LOCALISATION].stages
    assert found.keys() == {"align"}
    assert (found["align"].count, found["align"].mean, found["align"].max) == (2, 2.0, 3.0)
    assert timing[CallKind.MAPPING].stages["align"].mean == 100.0


@pytest.mark.parametrize(
    ("figure", "stage"), [("stage_align_s", "align"), ("align_s", None), ("stage__s", None), ("stage_x", None)]
)
def test_the_name_of_a_stage(figure: str, stage: str | None) -> None:
    assert stage_of(figure) == stage


def test_long_series_keep_their_peaks() -> None:
    seconds = np.full(50_000, 0.01)
    seconds[12_345] = 9.0
    nothing = np.full(50_000, np.nan)
    details = score_calls(Calls(np.arange(50_000), seconds, ["tracking"] * 50_000, nothing, nothing)).details
    assert details is not None
    assert details.localisation is not None
    series = details.localisation.series
    assert len(series.stamp_ns) <= 2000
    assert max(value for value in series.processing_time_s if value is not None) == pytest.approx(9.0)


def calls_of(state: str, seconds: float) -> ScoredCalls:
    nothing = np.full(1, np.nan)
    return score_calls(Calls(np.arange(1), np.array([seconds]), [state], nothing, nothing))


def test_calls_of_several_files_are_merged_by_kind() -> None:
    both = calls_of("tracking", 1.0).merged(calls_of("mapped", 2.0))
    assert [(kind, calls.mean) for kind, calls in both.timing.kinds()] == [("localisation", 1.0), ("mapping", 2.0)]
    assert both.details is not None
    assert None not in (both.details.localisation, both.details.mapping)
    again = dict(both.merged(calls_of("mapped", 3.0)).timing.kinds())
    assert again[CallKind.MAPPING].mean == 3.0, "the later file counts"


@pytest.mark.clause("4.2.1", "4.2.2")
def test_a_target_stands_under_its_own_name() -> None:
    nothing = np.full(1, np.nan)
    unmeasured = score_target(Calls(np.arange(1), np.ones(1), [""], nothing, nothing), "GR740")
    assert unmeasured.timing.localisation is not None
    assert unmeasured.timing.localisation.clock == "GR740"
    assert unmeasured.memory == MemoryScore()
    measured = score_target(Calls(np.arange(1), np.ones(1), [""], np.array([7.0]), nothing), "GR740")
    assert measured.memory.method == "as measured on GR740"
