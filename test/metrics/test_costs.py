import numpy as np
import pytest

from sfr_loc_map.metrics.resource_score import Calls, merge_parts, score_calls, stage_of


def test_localisation_mapping_and_fusion_are_told_apart() -> None:
    calls = Calls(
        np.arange(5),
        np.array([1.0, 2.0, 3.0, 4.0, 5.0]),
        ["initialising", "tracking", "mapped", "mapped", "fused"],
        np.array([10.0, 30.0, 20.0, np.nan, 5.0]),
        np.array([1.0, 3.0, 2.0, np.nan, 0.0]),
    )
    got = score_calls(calls)
    assert got["timing"]["localisation_s"]["mean"] == 1.5
    assert got["timing"]["mapping_s"]["max"] == 4.0
    assert got["timing"]["fusion_s"]["count"] == 1
    assert got["memory"]["localisation_peak_bytes"] == 30
    assert got["memory"]["mapping_above_idle_bytes"] == 2
    assert got["timing"]["mapping_s"]["clock"] == "host monotonic"


def test_unknown_memory_is_null_and_said() -> None:
    nothing = np.full(2, np.nan)
    got = score_calls(Calls(np.arange(2), np.ones(2), ["tracking", "lost"], nothing, nothing))
    assert got["memory"]["localisation_peak_bytes"] is None
    assert got["memory"]["method"].startswith("not measured")


def test_stages_are_summed_up_over_the_calls_that_had_them() -> None:
    nothing = np.full(4, np.nan)
    stages = {"align": np.array([1.0, 3.0, np.nan, 100.0]), "never": nothing}
    states = ["tracking", "tracking", "lost", "mapped"]
    timing = score_calls(Calls(np.arange(4), np.ones(4), states, nothing, nothing, stages))["timing"]
    found = timing["localisation_s"]["stages"]
    assert found.keys() == {"align"}
    assert (found["align"]["count"], found["align"]["mean"], found["align"]["max"]) == (2, 2.0, 3.0)
    assert timing["mapping_s"]["stages"]["align"]["mean"] == 100.0


@pytest.mark.parametrize(
    ("figure", "stage"), [("stage_align_s", "align"), ("align_s", None), ("stage__s", None), ("stage_x", None)]
)
def test_the_name_of_a_stage(figure: str, stage: str | None) -> None:
    assert stage_of(figure) == stage


def test_long_series_keep_their_peaks() -> None:
    seconds = np.full(50_000, 0.01)
    seconds[12_345] = 9.0
    nothing = np.full(50_000, np.nan)
    series = score_calls(Calls(np.arange(50_000), seconds, ["tracking"] * 50_000, nothing, nothing))
    series = series["details"]["calls"]["localisation"]["series"]
    assert len(series["stamp_ns"]) <= 2000
    assert max(series["processing_time_s"]) == pytest.approx(9.0)


def test_parts_are_merged_one_level_down() -> None:
    first = {"timing": {"a": 1}, "details": {"calls": {"localisation": 1}}}
    second = {"timing": {"b": 2}, "details": {"calls": {"mapping": 2}, "map": 3}}
    assert merge_parts(first, second) == {
        "timing": {"a": 1, "b": 2},
        "details": {"calls": {"localisation": 1, "mapping": 2}, "map": 3},
    }
