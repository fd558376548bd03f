# ruff: noqa: E402 - ROS may be absent
import math

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.serialization import deserialize_message, serialize_message

from sfr_loc_map.errors import InputError
from sfr_loc_map.metrics.resources import CallUsage
from sfr_loc_map.nodes.diagnostics.call_reporter import Call, CallReporter, task_record
from sfr_loc_map.nodes.diagnostics.key_values import Level, level_of, status_msg, values_of

STEP = np.random.default_rng(0).normal(size=27) / 3.0


def published(usage: CallUsage) -> DiagnosticStatus:
    node = rclpy.create_node("tried", namespace="/rover")
    taken: list[DiagnosticArray] = []
    reporter = CallReporter(node, "localisation", type("P", (), {"publish": staticmethod(taken.append)}))
    statistics = {"inliers": np.float64(1 / 3), "features": 12}
    reporter.publish(
        Call(5, usage, "lost", Level.ERROR, statistics, reason="few_landmarks", step=STEP), {"dropped_stale": 4}
    )
    node.destroy_node()
    return deserialize_message(serialize_message(taken[0]), DiagnosticArray).status[0]


def test_a_call_comes_back_to_the_last_bit(ros: None) -> None:
    status = published(CallUsage(0.1 + 0.2, 123456789, 1000))
    assert status.name == "rover/tried: call"
    assert (level_of(status), status.message) == (Level.ERROR, "lost: few_landmarks")
    assert values_of(status)["dropped_stale"] == "4"
    found = task_record(status)
    assert found is not None
    assert found.task == "localisation"
    record = found.record
    assert (record.stamp_ns, record.processing_time_s) == (5, 0.1 + 0.2)
    assert (record.state, record.reason) == ("lost", "few_landmarks")
    assert (record.peak_rss_bytes, record.above_idle_bytes) == (123456789, 1000)
    np.testing.assert_array_equal(record.step, STEP)
    assert record.statistics == {"inliers": 1 / 3, "features": 12.0}


def test_memory_that_was_not_measured_is_none(ros: None) -> None:
    found = task_record(published(CallUsage(1.0)))
    assert found is not None
    assert found.record.peak_rss_bytes is None


def test_other_statuses_are_passed_over_and_broken_ones_named() -> None:
    assert task_record(status_msg("battery", Level.OK, "", {"volts": 12.5})) is None
    assert task_record(DiagnosticStatus()) is None
    broken = status_msg(
        "n: call", Level.OK, "", {"task": "mapping", "processing_time_s": "soon", "stamp_ns": 1, "state": "x"}
    )
    with pytest.raises(InputError, match="status 'n: call' on /diagnostics cannot be read"):
        task_record(broken)
    missing = status_msg("n: call", Level.OK, "", {"task": "mapping", "processing_time_s": 1.0})
    with pytest.raises(InputError, match="stamp_ns"):
        task_record(missing)


def test_values_read_back_to_the_same_number() -> None:
    values = {"a": 1 / 3, "b": np.float64(2 / 3), "c": np.int64(7), "d": True, "e": math.inf, "f": "text"}
    texts = values_of(status_msg("s", Level.OK, "", values))
    assert (float(texts["a"]), float(texts["b"]), texts["c"], texts["d"], texts["f"]) == (
        1 / 3,
        2 / 3,
        "7",
        "True",
        "text",
    )
    assert float(texts["e"]) == math.inf


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("stamp_ns", "9" * 30),
        ("stamp_ns", "9" * 5000),
        ("stamp_ns", "-1"),
        ("processing_time_s", "nan"),
        ("processing_time_s", "-0.1"),
        ("processing_time_s", "1e400"),
        ("peak_rss_bytes", "9" * 30),
    ],
)
def test_a_call_whose_figures_no_array_could_hold_is_refused(name: str, text: str) -> None:
    values = {"task": "localisation", "stamp_ns": "5", "state": "tracking", "processing_time_s": "0.1"}
    values |= {"peak_rss_bytes": "7", "above_idle_bytes": "3"} | {name: text}
    with pytest.raises(InputError, match="cannot be read"):
        task_record(status_msg("n: call", Level.OK, "tracking", values))
