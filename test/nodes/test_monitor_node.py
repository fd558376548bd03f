"""The monitor node over DDS."""

# ruff: noqa: E402 - ROS may be absent
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

from diagnostic_msgs.msg import DiagnosticArray
from made_scene import PERIOD_NS, START_NS
from nav_msgs.msg import Odometry
from peers import Capture, LocalNode
from processes import Peer
from rclpy.qos import DurabilityPolicy, QoSProfile
from scenes import problems, raw
from std_msgs.msg import Float64, String

from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes.diagnostics import values_of
from sfr_loc_map.nodes.monitor_node import MonitorNode

CONFIGURATION, DIAGNOSTICS = "localisation/configuration", (DiagnosticArray, "/diagnostics")


def test_the_monitor_scores_what_it_receives(ros: None, capfd: Capture, tmp_path: Path) -> None:
    save = tmp_path / "score.json"
    limits = tmp_path / "limits.yaml"
    limits.write_text("trajectory:\n - condition: frames=5\n   position_mean_plus_3sigma_m: 0.001\n", encoding="utf-8")
    arguments = [
        "--ros-args",
        "-p",
        f"save_file:={save}",
        "-p",
        f"limits_file:={limits}",
        "-p",
        "publish_period_s:=0.1",
    ]
    arguments += ["-p", "score.trajectory.conditions:=['frames=5']", "-p", "score.trajectory.spacing:=5"]
    with Peer() as peer, LocalNode(peer, capfd, MonitorNode, *arguments):
        report = peer.listen(String, "metrics/report", latched=True)
        means = peer.listen(Float64, "metrics/position/mean")
        metrics = peer.listen(DiagnosticArray, "metrics")
        for index in range(21):
            for topic, stretch in (("ground_truth/odometry", 1.0), ("localisation/odometry", 1.01)):
                position = np.array([0.1 * index * stretch, 0.0, 0.0])
                message = bag_messages.odometry(START_NS + index * PERIOD_NS, position, np.array([0.0, 0.0, 0.0, 1.0]))
                peer.publish(Odometry, topic, raw(message))

        def whole() -> dict | None:
            score = json.loads(report[-1].data) if report else {}
            return score if score.get("trajectory", {}).get("matched") == 21 else None

        score = peer.until(whole, "the report")
        # 5 frames are 0.5 m; 1 % too long: 5 mm each time, without spread.
        assert score["trajectory"]["count"] == 4
        assert score["trajectory"]["position_m"]["mean"] == pytest.approx(0.005, abs=1e-12)
        assert score["trajectory"]["position_m"]["sigma"] == pytest.approx(0.0, abs=1e-12)
        assert score["verdicts"][0]["verdict"] == "fail"
        peer.until(lambda: means and means[-1].data == score["trajectory"]["position_m"]["mean"], "the figure")

        def verdicts() -> list[tuple[bytes, str]]:
            statuses = metrics[-1].status if metrics else []
            return [(status.level, status.message) for status in statuses if status.name.startswith("verdict/")]

        peer.until(lambda: verdicts() == [(b"\x02", "fail")], "the verdict")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        hostile, diagnostics = peer.node.create_publisher(String, CONFIGURATION, latched), peer.listen(*DIAGNOSTICS)
        for text, words in (("[1]", "no JSON object"), (json.dumps({"x": "x" * 2_000_000}), "2000009 characters")):
            peer.until(hostile.get_subscription_count, "the monitor")
            hostile.publish(String(data=text))
            peer.until(lambda words=words: words in " ".join(problems(diagnostics)), words)
        answer = peer.call("monitor_node/save")
        assert (answer.success, answer.message) == (True, str(save))
        saved = json.loads(save.read_text())
        assert saved["trajectory"] == score["trajectory"]
        assert saved["provenance"]["configuration"]["monitor"]["score.trajectory.spacing"] == 5
        assert list(saved["provenance"]["configuration"]) == ["monitor"]
        assert peer.call("monitor_node/reset").success
        peer.until(lambda: "trajectory" not in json.loads(report[-1].data), "the reset")


SHORT_PERIOD_NS = 20_000_000
MANY, KEPT = 200, 5
"""Poses that are sent, and how many the monitor has room for."""


def test_the_monitor_counts_the_poses_that_it_had_no_room_for(ros: None, capfd: Capture) -> None:
    arguments = [
        "--ros-args",
        "-p",
        f"input_depth:={KEPT}",
        "-p",
        "publish_period_s:=0.1",
        "-p",
        "health.period_s:=0.2",
    ]
    with Peer() as peer, LocalNode(peer, capfd, MonitorNode, *arguments):
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        reports = peer.listen(String, "metrics/report", latched=True)

        def send(number: int, topic: str = "localisation/odometry") -> None:
            position, turn = np.array([0.01 * number, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])
            message = bag_messages.odometry((number + 1) * SHORT_PERIOD_NS, position, turn)
            peer.publish(Odometry, topic, raw(message))

        def scored() -> int:
            score: dict[str, Any] = json.loads(reports[-1].data) if reports else {}
            return int(score.get("trajectory", {}).get("estimate_poses", 0))

        def counted() -> int:
            found = [status for array in diagnostics for status in array.status if status.name.endswith(": health")]
            values = values_of(found[-1]) if found else {}
            return sum(int(value) for name, value in values.items() if name.startswith("dropped_"))

        send(0, "ground_truth/odometry")
        send(0)
        peer.until(lambda: scored() == 1, "the first pose in the score")
        for number in range(1, MANY):  # nobody receives meanwhile
            send(number)
        peer.until(lambda: scored() + counted() == MANY, "the others, in the score or counted")
        assert counted() > 0
