"""What a node says of itself: health by what happened, calls to the last bit."""

from dataclasses import astuple
from types import SimpleNamespace

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from scenes import sent

from sfr_loc_map.metrics.calls import CallUsage
from sfr_loc_map.nodes.diagnostics import HealthConfig, Level, NodeActivity, StatusReporter, level_of, status_msg
from sfr_loc_map.pipeline.call_stats import CallRecord, task_record, values_of

STEP = np.random.default_rng(0).normal(size=48) / 3.0


def published(usage: CallUsage) -> DiagnosticStatus:
    node = rclpy.create_node("tried", namespace="/rover")
    reporter = StatusReporter(node, "localisation", HealthConfig(), lambda: NodeActivity("active", {}, 0, False))
    taken: list[DiagnosticArray] = []
    reporter.publisher = SimpleNamespace(publish=taken.append)
    statistics = {"inliers": np.float64(1 / 3), "features": 12}
    call = CallRecord(5, *astuple(usage)[:1], "lost", *astuple(usage)[1:], statistics, None, "few_landmarks", STEP)
    reporter.call(call, Level.ERROR, {"latency_x_s": 0.5}, {"dropped_stale": 4})
    node.destroy_node()
    return sent(taken[0]).status[0]


def test_a_call_comes_back_to_the_last_bit(ros: None) -> None:
    status = published(CallUsage(0.1 + 0.2, 123456789, 1000))
    assert (status.name, level_of(status), status.message) == ("rover/tried: call", Level.ERROR, "lost: few_landmarks")
    assert values_of(status)["dropped_stale"] == "4"
    record = task_record(status)
    assert (record.task, record.stamp_ns, record.processing_time_s) == ("localisation", 5, 0.1 + 0.2)
    assert (record.state, record.reason) == ("lost", "few_landmarks")
    assert (record.peak_rss_bytes, record.above_idle_bytes) == (123456789, 1000)
    np.testing.assert_array_equal(record.step, STEP)
    assert record.statistics == {"inliers": 1 / 3, "features": 12.0}
    assert task_record(published(CallUsage(1.0))).peak_rss_bytes is None
    assert task_record(status_msg("battery", Level.OK, "", {"volts": 12.5})) is None
