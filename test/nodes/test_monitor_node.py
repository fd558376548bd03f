"""The monitor node over DDS."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64, String

from helpers.made_scene import PERIOD_NS, START_NS
from helpers.node_scenes import params, raw
from helpers.peers import Capture, LocalNode, Manager
from helpers.score_rows import row
from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes.monitor_node import MonitorNode

NO_TURN = np.array([0.0, 0.0, 0.0, 1.0])


def association_of(reports: list[String]) -> dict[str, Any]:
    """Return how the last report associates poses, empty where it does not."""
    return json.loads(reports[-1].data).get("association") or {} if reports else {}


def test_the_monitor_scores_what_it_receives(ros: None, capfd: Capture, tmp_path: Path) -> None:
    save, limits = tmp_path / "score.json", tmp_path / "limits.yaml"
    limits.write_text("trajectory:\n - condition: frames=5\n   position_mean_plus_3sigma_m: 0.001\n", encoding="utf-8")
    arguments = params(f"save_file:={save}", f"limits_file:={limits}", "publish_period_s:=0.1")
    arguments += params("score.trajectory.conditions:=['frames=5']", "score.trajectory.spacing:=5")
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments):
        report = peer.listen(String, "metrics/report", latched=True)
        means = peer.listen(Float64, "metrics/position/mean")
        metrics = peer.listen(DiagnosticArray, "metrics")
        for index in range(21):
            for topic, stretch in (("ground_truth/odometry", 1.0), ("localisation/odometry", 1.01)):
                position = np.array([0.1 * index * stretch, 0.0, 0.0])
                peer.publish(
                    Odometry, topic, raw(bag_messages.odometry(START_NS + index * PERIOD_NS, position, NO_TURN))
                )
        peer.until(lambda: association_of(report).get("matched") == 21, "the report")
        score = json.loads(report[-1].data)
        # 5 frames are 0.5 m; 1 % too long: 5 mm each time, without spread.
        position = row(score, "position")
        assert position["n"] == 4
        assert position["mean"] == pytest.approx(0.005, abs=1e-12)
        assert position["sigma"] == pytest.approx(0.0, abs=1e-12)
        assert score["verdicts"][0]["verdict"] == "fail"
        peer.until(lambda: means and means[-1].data == position["mean"], "the figure")

        def verdicts() -> list[tuple[bytes, str]]:
            statuses = metrics[-1].status if metrics else []
            return [(status.level, status.message) for status in statuses if status.name.startswith("verdict/")]

        peer.until(lambda: verdicts() == [(b"\x02", "fail")], "the verdict")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        hostile = peer.node.create_publisher(String, "localisation/configuration", latched)
        for text, words in (("[1]", "no JSON object"), (json.dumps({"x": "x" * 2_000_000}), "2000009 characters")):
            peer.until(hostile.get_subscription_count, "the monitor")
            hostile.publish(String(data=text))
            peer.refused(words)
        answer = peer.call("monitor_node/save")
        assert (answer.success, answer.message) == (True, str(save))
        saved = json.loads(save.read_text())
        assert saved["figures"] == score["figures"]
        assert saved["provenance"]["configuration"]["monitor"]["score.trajectory.spacing"] == 5
        assert list(saved["provenance"]["configuration"]) == ["monitor"]
        assert peer.call("monitor_node/reset").success
        peer.until(lambda: not association_of(report), "the reset")


@pytest.mark.parametrize("topic", ["ground_truth/odometry", "localisation/odometry"])
@pytest.mark.parametrize("stray_ns", [0, START_NS - 5 * 10**9, START_NS + 4 * 3600 * 10**9])
def test_a_stray_pose_is_dropped_and_counted_and_a_run_that_begins_again_restarts_the_score(
    ros: None, capfd: Capture, topic: str, stray_ns: int
) -> None:
    arguments = params("publish_period_s:=0.1", "score.trajectory.conditions:=['frames=3']", "health.period_s:=0.1")
    arguments += params("score.trajectory.spacing:=2")
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments) as node:
        report = peer.listen(String, "metrics/report", latched=True)

        def send(where: str, stamp_ns: int, x: float) -> None:
            peer.publish(Odometry, where, raw(bag_messages.odometry(stamp_ns, np.array([x, 0.0, 0.0]), NO_TURN)))

        def drive(count: int) -> None:
            for index in range(count):
                for where in ("ground_truth/odometry", "localisation/odometry"):
                    send(where, START_NS + 2 * index * 10**9, 0.1 * index)

        drive(8)
        send(topic, stray_ns, 50.0)
        for where in ("ground_truth/odometry", "localisation/odometry"):
            send(where, START_NS + 16 * 10**9, 0.8)
        peer.until(lambda: association_of(report).get("matched") == 9, "the report of the whole drive")
        assert node.node.counts()["dropped_stray"] == 1
        assert "the score restarts" not in node.text
        drive(5)
        node.wait_for("the score restarts")
        peer.until(lambda: association_of(report).get("matched") == 5, "the report of the new run")
        assert node.node.counts()["dropped_stray"] == 1
