"""What a node reports of itself for people: state, time and memory of a call as readable values."""

from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray

from helpers.node_scenes import sent
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.metrics.calls.call_meter import METHOD
from sfr_loc_map.nodes.lifecycle.diagnostics import HealthConfig, Level, NodeSnapshot, StatusReporter
from sfr_loc_map.ros.statuses import level_of, values_of


def test_a_call_is_reported_in_readable_values(ros: None) -> None:
    node = rclpy.create_node("tried", namespace="/rover")
    reporter = StatusReporter(node, "localisation", HealthConfig(), lambda: NodeSnapshot("active", {}, 0, False))
    taken: list[DiagnosticArray] = []
    reporter.publisher = SimpleNamespace(publish=taken.append)
    about = {"reason": "few_landmarks", "step": np.ones(48), "times": {"conversion_s": 0.5}, "counts": {"dropped_x": 4}}
    reporter.report_call(
        CallRecord(5, 0.25, "lost", peak_rss_bytes=123456789, statistics={"inliers": 1 / 3}, **about),
        Level.ERROR,
        METHOD,
    )
    node.destroy_node()
    status = sent(taken[0]).status[0]
    assert (status.name, level_of(status), status.message) == ("rover/tried: call", Level.ERROR, "lost: few_landmarks")
    values = values_of(status)
    assert (values["state"], values["reason"]) == ("lost", "few_landmarks")
    assert (values["processing_time_s"], values["peak_rss_bytes"]) == ("0.25", "123456789")
    assert (values["conversion_s"], values["dropped_x"]) == ("0.5", "4")
    assert "above_idle_bytes" not in values, "unknown"
    assert max(len(text) for text in values.values()) < 100


def test_problems_that_differ_in_their_numbers_are_one_and_another_kind_is_logged(
    ros: None, capfd: pytest.CaptureFixture[str]
) -> None:
    node = rclpy.create_node("tried")
    reporter = StatusReporter(node, "localisation", HealthConfig(), lambda: NodeSnapshot("active", {}, 0, False))
    taken: list[DiagnosticArray] = []
    reporter.publisher = SimpleNamespace(publish=taken.append)
    for stamp in range(3):
        reporter.error(f"image of stamp {stamp} is too small")
    reporter.error("the calibration is empty")
    reporter.publish_health()
    node.destroy_node()
    texts = [array.status[0].message for array in taken if array.status[0].name.endswith("health")]
    assert texts[-1] == "the calibration is empty; image of stamp 2 is too small"
    logged = capfd.readouterr().err
    assert (logged.count("is too small"), logged.count("calibration is empty")) == (1, 1)
