"""What an external node told and what was seen of it from outside, as rows and figures named for what they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sfr_loc_map.geometry.pose_convention import PoseConvention
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.calls import NODE_CLOCK, ScoredCalls, score_calls, with_external
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.score import (
    AnswerCounts,
    ExternalScore,
    MemoryScore,
    MethodKind,
    MethodRecord,
    ProcessUsage,
    TimingScore,
)
from sfr_loc_map.pipeline.call_stats import CallRecord, CallStats, load_call_stats, save_stats
from sfr_loc_map.pipeline.replay import ExternalRun, ReplayResult
from sfr_loc_map.pipeline.scoring import Correction

USAGE = ProcessUsage(cpu_s=1.0, peak_rss_bytes=5_000, processes=2, method="as seen from outside")
NODE = ExternalScore(task="localisation", topic="odom", frames="a -> b", answers=AnswerCounts(), latency_s=None)
METHOD = MethodRecord(name="theirs", version=None, kind=MethodKind.EXTERNAL)


def poses() -> Trajectory:
    return Trajectory(np.arange(4) * 100, np.arange(12.0).reshape(4, 3), Rotation.random(4, random_state=1).as_quat())


def run_of(*settings: str) -> ExternalRun:
    return ExternalRun(METHOD, NODE, (), Correction(PoseConvention.parse(settings)))


def test_each_pose_has_a_row_with_the_time_that_the_node_told_or_none(tmp_path: Path) -> None:
    told = [
        CallRecord(0, 0.25, "tracking", None, None, covariance=np.diag([1.0, 2, 3, 4, 5, 6])),
        CallRecord(100, float("nan"), "tracking", None, None, covariance=9999.0 * np.eye(6)),
        CallRecord(500, 0.5, "mapped", 7, 7),
    ]
    config = ScoreConfig()
    published = ReplayResult(poses(), None, told, "", ())
    converted = published.converted(run_of("metres_per_unit=0.1"), None, None, config)
    found, records, run = converted.estimate, converted.records, converted.external
    assert run is not None
    np.testing.assert_allclose(found.positions, 0.1 * poses().positions)
    assert run.as_published is not None
    np.testing.assert_array_equal(run.as_published.positions, poses().positions)
    assert run.convention is not None
    assert run.convention.declared == ("metres_per_unit=0.1",)
    assert [item.state for item in records] == ["tracking", "lost", "tracking", "tracking", "mapped"]
    assert records[0].covariance is not None
    np.testing.assert_allclose(np.diag(records[0].covariance), [0.01, 0.02, 0.03, 4, 5, 6])
    assert records[2].covariance is None
    save_stats(tmp_path / "stats.csv", records)
    stats = load_call_stats(tmp_path / "stats.csv")
    scored = score_calls(stats.calls)
    assert scored.timing.localisation is not None
    assert (scored.timing.localisation.count, scored.timing.localisation.mean) == (1, 0.25)
    assert isinstance(stats, CallStats)
    seen = with_external(scored, replace(NODE, process=USAGE))
    assert seen.timing.localisation is not None
    assert seen.timing.localisation.clock == NODE_CLOCK
    assert seen.timing.mapping is not None
    assert seen.timing.mapping.clock != NODE_CLOCK
    assert seen.memory.localisation is not None
    assert seen.memory.localisation.peak_bytes == 5_000
    assert seen.memory.mapping is not None
    assert seen.memory.mapping.peak_bytes == 7
    assert str(seen.memory.method).startswith("localisation: as seen from outside; others: ")


def test_a_latency_is_never_a_time_per_call() -> None:
    nothing = ScoredCalls(TimingScore(), MemoryScore(), None)
    assert with_external(nothing, NODE) == nothing
    seen = with_external(nothing, replace(NODE, task="mapping", process=USAGE))
    assert list(seen.timing.kinds()) == []
    assert seen.memory.mapping is not None
    assert seen.memory.method == "mapping: as seen from outside"


def test_nothing_published_is_nothing_converted() -> None:
    nothing = ReplayResult(Trajectory.empty(), None, [], "", ())
    assert nothing.converted(run_of("inverse=true"), None, None, ScoreConfig()) is nothing
