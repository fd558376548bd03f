"""The monitor node over DDS."""

import json
import math
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, PoseWithCovarianceStamped, TransformStamped
from lifecycle_msgs.msg import Transition
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, NavSatFix, PointCloud2
from std_msgs.msg import Float64, String

from helpers.made_scene import LOC_RIG, NAV_RIG, PERIOD_NS, START_NS, nav_pair
from helpers.made_suites import SFR
from helpers.manager import Capture, LocalNode, Manager
from helpers.node_scenes import params, raw, send_infos
from helpers.score_rows import row, rows_about
from sfr_loc_map.calls.call_message import encode_call
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import Level
from sfr_loc_map.metrics.score.score import SCHEMA
from sfr_loc_map.nodes.monitor_node import MonitorNode
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.pose_messages import pose_msg, transform_msg

NO_TURN = np.array([0.0, 0.0, 0.0, 1.0])


def association_of(reports: list[String]) -> dict[str, Any]:
    """Return how the last report associates poses, empty where it does not."""
    return json.loads(reports[-1].data).get("association") or {} if reports else {}


def test_the_monitor_scores_what_it_receives(ros: None, capfd: Capture, tmp_path: Path) -> None:
    save, limits = tmp_path / "score.json", tmp_path / "limits.yaml"
    limits.write_text(
        "minimum_independent: 2\ntrajectory:\n - condition: frames=5\n   position_mean_plus_3sigma_m: 0.001\n",
        encoding="utf-8",
    )
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
        assert score["verdicts"][-1]["verdict"] == "fail"
        peer.until(lambda: means and means[-1].data == position["mean"], "the figure")

        def verdicts() -> list[tuple[bytes, str]]:
            statuses = metrics[-1].status if metrics else []
            return [(status.level, status.message) for status in statuses if status.name.startswith("verdict/")]

        peer.until(lambda: (b"\x02", "fail") in verdicts(), "the verdict")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        hostile = peer.node.create_publisher(String, "localisation/configuration", latched)
        for text, words in (("[1]", "not a JSON object"), (json.dumps({"x": "x" * 2_000_000}), "2000009 characters")):
            peer.until(hostile.get_subscription_count, "the monitor")
            hostile.publish(String(data=text))
            peer.refused(words)
        answer = peer.call("monitor_node/save")
        assert (answer.success, answer.message) == (True, str(save))
        saved = json.loads(save.read_text())
        assert rows_about(saved, "trajectory") == rows_about(score, "trajectory")
        assert row(saved, "judged") == row(saved, "judged") | {"n": 21, "value": 1.0}, "all results are due"
        configuration = saved["provenance"]["configuration"]
        assert configuration["trajectory.spacing"] == 5
        assert not [name for name in configuration["monitor"] if name.startswith("score.")], "settings are stated once"
        assert "localisation" not in configuration, "the hostile configurations are ignored"
        assert peer.call("monitor_node/reset").success
        peer.until(lambda: not association_of(report), "the reset")
        interval = f"{START_NS} to {START_NS + 20 * PERIOD_NS} ns (~/reset)"
        assert any(interval in text for text in warnings_of(report))


def test_a_run_without_any_pose_for_its_images_is_incomplete(ros: None, capfd: Capture, tmp_path: Path) -> None:
    save = tmp_path / "score.json"
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *params(f"save_file:={save}")):
        for index in range(3):
            message = bag_messages.camera_info(START_NS + index * PERIOD_NS, LOC_RIG, "loc", "left")
            peer.publish(CameraInfo, "loc/left/camera_info", raw(message))

        def incomplete() -> str:
            assert peer.call("monitor_node/save").success
            return json.loads(save.read_text())["incomplete"] or ""

        peer.until(lambda: "no pose for any of 3 images" in incomplete(), "the images")


def test_the_report_of_the_previous_process_is_kept_at_an_activation(ros: None, capfd: Capture, tmp_path: Path) -> None:
    save, before = tmp_path / "score.json", tmp_path / "score.before.json"
    previous = json.dumps({"schema": SCHEMA, "of": "the previous process"})
    save.write_text(previous, encoding="utf-8")
    arguments = params(f"save_file:={save}", "save_period_s:=3600.0")
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments):
        assert before.read_text() == previous
        assert peer.call("monitor_node/save").success
        assert peer.change(Transition.TRANSITION_DEACTIVATE) == (True, "inactive")
        assert peer.change(Transition.TRANSITION_ACTIVATE) == (True, "active")
        assert before.read_text() == previous
        assert json.loads(save.read_text())["schema"] == SCHEMA


def test_scored_estimates_are_not_reported_as_missed_after_another_activation(ros: None, capfd: Capture) -> None:
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode) as local:
        node = local.node

        def estimate_at(index: int) -> None:
            message = bag_messages.odometry(START_NS + index * PERIOD_NS, np.zeros(3), NO_TURN)
            peer.publish(Odometry, "localisation/odometry", raw(message))
            peer.until(lambda: len(node._score.rows._estimates) == index + 1, "the estimate")

        estimate_at(0)
        estimate_at(1)
        assert peer.change(Transition.TRANSITION_DEACTIVATE) == (True, "inactive")
        assert peer.change(Transition.TRANSITION_ACTIVATE) == (True, "active")
        estimate_at(2)
        assert node.counts()["dropped_in_transport"] == 0
        assert not [text for text in node._result().caveats if "published before" in text]


def warnings_of(report: list[String]) -> list[str]:
    return list(json.loads(report[-1].data)["warnings"])


def test_half_of_the_estimates_are_incomplete_up_to_the_signed_report(
    ros: None, capfd: Capture, tmp_path: Path
) -> None:
    save, limits, junit = (tmp_path / name for name in ("score.json", "limits.yaml", "score.xml"))
    limits.write_text(
        "minimum_independent: 2\ntrajectory:\n - condition: frames=5\n   position_mean_plus_3sigma_m: 1\n",
        encoding="utf-8",
    )
    arguments = params(f"save_file:={save}", f"limits_file:={limits}", "publish_period_s:=0.1")
    arguments += params("score.trajectory.conditions:=['frames=5']", "score.trajectory.spacing:=5")
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments):
        report = peer.listen(String, "metrics/report", latched=True)
        for index in range(61):
            for topic, stretch in (("ground_truth/odometry", 1.0), ("localisation/odometry", 1.01)):
                if topic.startswith("ground") or index < 30:
                    position = np.array([0.1 * index * stretch, 0.0, 0.0])
                    message = bag_messages.odometry(START_NS + index * PERIOD_NS, position, NO_TURN)
                    peer.publish(Odometry, topic, raw(message))
        peer.until(lambda: association_of(report).get("matched") == 30, "the report")
        assert peer.call("monitor_node/save").success
    saved = json.loads(save.read_text())
    assert saved["verdict"] == "incomplete"
    assert row(saved, "judged")["value"] < 0.5
    signed = tmp_path / "signed.html"
    command = [*SFR, "report", str(save), "--test-report", str(signed), "--junit", str(junit)]
    assert subprocess.run(command, check=False, stdout=subprocess.DEVNULL).returncode == 3
    assert "<strong>INCOMPLETE</strong>" in signed.read_text()
    assert "<error" in junit.read_text()


@pytest.mark.parametrize("topic", ["ground_truth/odometry", "localisation/odometry"])
@pytest.mark.parametrize("stray_ns", [0, START_NS - 5 * 10**9, START_NS + 4 * 3600 * 10**9])
def test_a_stray_pose_is_dropped_and_counted_and_a_run_that_begins_again_restarts_the_score(
    ros: None, capfd: Capture, topic: str, stray_ns: int
) -> None:
    arguments = params("publish_period_s:=0.1", "score.trajectory.conditions:=['frames=3']", "health.period_s:=0.1")
    arguments += params("score.trajectory.spacing:=2")
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments) as node:
        report = peer.listen(String, "metrics/report", latched=True)
        metrics = peer.listen(DiagnosticArray, "metrics")

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
        peer.until(lambda: stamp_of(metrics[-1]) == START_NS + 8 * 10**9, "figures with the stamp of the new run")
        assert node.node.counts()["dropped_stray"] == 1


def test_a_mapping_recording_that_is_played_again_restarts_the_score_with_all_calls_and_pairs(
    ros: None, capfd: Capture
) -> None:
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode) as node:
        for run in range(2):
            for second in range(6):
                stamp_ns = START_NS + second * 10**9
                call = CallRecord(stamp_ns, 0.1, "mapped")
                peer.publish(String, "mapping_node/call", String(data=encode_call(call)))
                message = PoseStamped(header=header_msg(stamp_ns, "lm"))
                peer.publish(PoseStamped, "nav/pose", message)
                if (run, second) == (1, 2):
                    node.wait_for("the score restarts")
        score = node.node._score
        peer.until(lambda: len(score.rows.calls) == 6 and len(score.map_inputs.pair_stamps_ns) == 6, "the new run")
        assert node.text.count("the score restarts") == 1
        assert peer.call("monitor_node/reset").success
        assert not score.map_inputs.pair_stamps_ns


def test_true_points_before_camera_info_are_kept_although_one_message_is_unusable(ros: None, capfd: Capture) -> None:
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode) as node:
        score = node.node._score
        pairs = [nav_pair(index) for index in range(2)]
        for item, truth in zip(pairs, (pairs[0].truth[:100], pairs[1].truth), strict=True):
            peer.publish(PointCloud2, "ground_truth/points", raw(bag_messages.points(item.pair.stamp_ns, truth, None)))
        peer.until(lambda: len(node.node._early_points) == 2, "both messages")
        send_infos(peer, "nav", NAV_RIG)
        peer.refused("ground_truth/points is 160 x 100")
        peer.until(
            lambda: pairs[1].pair.stamp_ns in score.map_inputs._true_points, "the true points of the second pair"
        )


@contextmanager
def tracker(kind: type[Any]) -> Iterator[Any]:
    """A publisher of true poses in a participant of its own: a topic has one type in each."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("tracker", context=context)
    yield node.create_publisher(kind, "ground_truth/odometry", 100)
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def turning_drive(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and quaternions of a curve with yaw, pitch and roll."""
    s = np.linspace(0.0, 6.0, count)
    quats = np.column_stack((0.05 * np.sin(s), 0.08 * np.cos(s), np.sin(0.2 * s), np.cos(0.2 * s)))
    quats /= np.linalg.norm(quats, axis=1)[:, None]
    return np.column_stack((s, 1.5 * np.sin(0.5 * s), 0.1 * s)), quats


def truth_message(kind: type[Any], stamp_ns: int, position: np.ndarray, quat: np.ndarray) -> Any:
    """Return a true pose as a message of a type."""
    message = kind(header=header_msg(stamp_ns, "map"))
    pose = pose_msg(Transform.from_quat(position, quat), quat)
    if kind is PoseStamped:
        message.pose = pose
    elif kind in (Odometry, PoseWithCovarianceStamped):
        message.pose.pose = pose
    elif kind is TransformStamped:
        message = transform_msg(message.header, "rb", pose)
    elif kind is PointStamped:
        message.point = pose.position
    else:
        east, north, up = position.tolist()
        message.latitude = 60.0 + math.degrees(north / 6_378_137.0)
        message.longitude = 24.0 + math.degrees(east / (6_378_137.0 * math.cos(math.radians(60.0))))
        message.altitude = up
    return message


@pytest.mark.parametrize(
    "kind",
    [PoseStamped, TransformStamped, PoseWithCovarianceStamped, PointStamped, NavSatFix, PathMessage],
    ids=lambda k: k.__name__,
)
def test_the_truth_may_have_each_type_that_is_scored_of_files(ros: None, capfd: Capture, kind: type[Any]) -> None:
    arguments = params("publish_period_s:=0.1", "score.trajectory.conditions:=['distance=1']")
    positions, quats = turning_drive(40)
    with ExitStack() as stack:
        peer = stack.enter_context(Manager("monitor_node"))
        node = stack.enter_context(LocalNode(peer, capfd, MonitorNode, *arguments))
        report = peer.listen(String, "metrics/report", latched=True)
        stamps = [START_NS + k * 10**8 for k in range(40)]

        def send_estimate(k: int) -> None:
            message = bag_messages.odometry(stamps[k], positions[k], quats[k])
            peer.publish(Odometry, "localisation/odometry", raw(message))

        send_estimate(0)
        peer.until(lambda: node.node._has_estimate, "the estimate")
        node.node.report_periodically()
        assert "nothing is scored without true poses on /ground_truth/odometry: no publisher" in node.text
        truth = stack.enter_context(tracker(kind))
        peer.until(lambda: node.node.count_publishers("/ground_truth/odometry"), "the publisher")
        node.node.report_periodically()
        peer.until(truth.get_subscription_count, "the subscription")
        for k in range(40):
            if k:
                send_estimate(k)
            if kind is PathMessage:  # each path repeats the poses before
                known = [truth_message(PoseStamped, stamps[n], positions[n], quats[n]) for n in range(k + 1)]
                truth.publish(PathMessage(header=known[-1].header, poses=known))
            else:
                truth.publish(truth_message(kind, stamps[k], positions[k], quats[k]))
        peer.until(lambda: association_of(report).get("matched") == 40, "the report of the whole drive")
        assert association_of(report)["truth_poses"] == 40
        score = json.loads(report[-1].data)
        errors = [item for item in score["figures"] if item["figure"] == "position" and item.get("part") != "growth"]
        error = next(item for item in errors if item.get("condition") == "distance=1")
        assert error["n"] > 0
        assert error["mean"] < 0.02
        assert score["truth"]["attitude"] is (kind not in (PointStamped, NavSatFix))


def test_another_publisher_of_results_or_truth_within_a_run_is_stated(ros: None, capfd: Capture) -> None:
    """A crashed item that was started again, and an item that publishes a ground truth beside the true one."""
    arguments = params("publish_period_s:=0.1")
    with ExitStack() as stack:
        peer = stack.enter_context(Manager("monitor_node"))
        stack.enter_context(LocalNode(peer, capfd, MonitorNode, *arguments))
        report = peer.listen(String, "metrics/report", latched=True)
        item = peer.node.create_publisher(Odometry, "localisation/odometry", 100)
        rogue = peer.node.create_publisher(Odometry, "ground_truth/odometry", 100)

        def changes() -> list[float]:
            figures = json.loads(report[-1].data)["figures"] if report else []
            return [item["value"] for item in figures if item["figure"] == "publisher_changes"]

        def send(publisher: Any, index: int) -> None:
            peer.until(publisher.get_subscription_count, "the monitor")
            publisher.publish(raw(bag_messages.odometry(START_NS + index * PERIOD_NS, np.zeros(3), NO_TURN)))

        for index in range(3):
            send(item, index)
        peer.until(lambda: changes() == [0.0], "a run with one publisher of each topic")
        peer.node.destroy_publisher(item)
        item = peer.node.create_publisher(Odometry, "localisation/odometry", 100)
        send(item, 3)
        peer.until(lambda: changes() == [1.0], "the second publisher of the estimates")
        assert any("localisation/odometry had more than one publisher" in text for text in warnings_of(report))
        assert peer.call("monitor_node/reset").success
        stack.enter_context(tracker(PoseStamped))
        send(rogue, 4)
        send(item, 4)
        words = "ground_truth/odometry had more than one publisher"
        later = count(5)

        def is_stated() -> bool:
            send(item, next(later))  # a score is published after new data only
            return any(words in text for text in warnings_of(report))

        peer.until(is_stated, "the second type of the ground truth")
        assert changes() == [1.0]
        assert any("published the estimates also published the ground truth" in text for text in warnings_of(report))


def test_a_truth_of_another_type_is_received_after_another_activation_with_the_same_origin(
    ros: None, capfd: Capture
) -> None:
    positions, quats = turning_drive(2)
    with ExitStack() as stack:
        peer = stack.enter_context(Manager("monitor_node"))
        node = stack.enter_context(LocalNode(peer, capfd, MonitorNode)).node
        truth = stack.enter_context(tracker(NavSatFix))
        peer.until(lambda: node.count_publishers("/ground_truth/odometry"), "the publisher")
        node.report_periodically()
        for k in range(2):
            if k:
                assert peer.change(Transition.TRANSITION_DEACTIVATE) == (True, "inactive")
                peer.until(lambda: not truth.get_subscription_count(), "the end of the subscription")
                assert peer.change(Transition.TRANSITION_ACTIVATE) == (True, "active")
            peer.until(truth.get_subscription_count, "the subscription")
            truth.publish(truth_message(NavSatFix, START_NS + k * 10**8, positions[k], quats[k]))
            peer.until(lambda count=k + 1: len(node._score.rows._truth) == count, "the true pose")
        assert np.linalg.norm(node._score.rows._truth.all()["position"][-1]) > 1.0


def test_a_clean_up_discards_the_score_and_the_score_after_it_states_the_discarded_data(
    ros: None, capfd: Capture, tmp_path: Path
) -> None:
    """Neither a clean-up nor a reset erases what the other one has discarded."""
    save = tmp_path / "score.json"
    arguments = params(f"save_file:={save}")
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments) as local:
        node = local.node
        peer.publish(Odometry, "localisation/odometry", raw(bag_messages.odometry(START_NS, np.zeros(3), NO_TURN)))
        peer.until(lambda: len(node._score.rows._estimates) == 1, "the estimate")
        assert peer.change(Transition.TRANSITION_DEACTIVATE) == (True, "inactive")
        assert len(node._score.rows._estimates) == 1
        assert peer.change(Transition.TRANSITION_CLEANUP) == (True, "unconfigured")
        assert not len(node._score.rows._estimates)
        assert peer.change(Transition.TRANSITION_CONFIGURE) == (True, "inactive")
        assert peer.change(Transition.TRANSITION_ACTIVATE) == (True, "active")
        message = bag_messages.odometry(START_NS + PERIOD_NS, np.zeros(3), NO_TURN)
        peer.publish(Odometry, "localisation/odometry", raw(message))
        peer.until(lambda: len(node._score.rows._estimates) == 1, "the second estimate")
        assert peer.call("monitor_node/reset").success
        assert peer.call("monitor_node/save").success
        (caveat,) = json.loads(save.read_text())["caveats"]
        assert f"{START_NS} to {START_NS} ns (clean-up or configuration)" in caveat
        assert f"{START_NS + PERIOD_NS} to {START_NS + PERIOD_NS} ns (~/reset)" in caveat


def test_figures_that_cannot_be_computed_are_not_reported_as_published(
    ros: None, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise MetricsError("the estimate has two runs")

    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode) as node:
        monkeypatch.setattr(node.node._score, "result", fail)
        answer = peer.call("monitor_node/finish")
        assert (answer.success, answer.message) == (False, "the estimate has two runs")


def test_a_truth_of_another_type_is_named(ros: None, capfd: Capture) -> None:
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode) as node, tracker(String):
        peer.publish(Odometry, "localisation/odometry", raw(bag_messages.odometry(START_NS, np.zeros(3), NO_TURN)))
        peer.until(lambda: node.node._has_estimate, "the estimate")
        peer.until(lambda: node.node.count_publishers("/ground_truth/odometry"), "the publisher")
        node.node.report_periodically()
        assert "the type is std_msgs/msg/String: nav_msgs/msg/Odometry" in node.text


def test_a_truth_in_ned_is_found_live_as_offline(ros: None, capfd: Capture) -> None:
    arguments = params("publish_period_s:=0.1", "score.trajectory.conditions:=['distance=1']", "health.period_s:=0.1")
    positions, quats = turning_drive(40)
    to_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments):
        report = peer.listen(String, "metrics/report", latched=True)
        body = np.diag([1.0, -1.0, -1.0])
        for k in range(40):
            stamp_ns, turn = START_NS + k * 10**8, matrix_from_quat(quats[k])
            estimate = Transform(to_ned @ turn @ body, to_ned @ positions[k])
            true = Transform(turn, positions[k])
            for topic, pose in (("localisation/odometry", estimate), ("ground_truth/odometry", true)):
                message = bag_messages.odometry(stamp_ns, pose.translation, pose.quat_xyzw)
                peer.publish(Odometry, topic, raw(message))
        peer.until(lambda: association_of(report).get("matched") == 40, "the report of the whole drive")
        peer.well(Level.WARN, "the estimate looks wrong:")
        assert json.loads(report[-1].data)["contradiction"]


def test_a_truth_on_tf_is_scored(ros: None, capfd: Capture) -> None:
    """A chain of two moving transforms, the second one at half the rate, as odometry and a map correction."""
    kind = pytest.importorskip("tf2_msgs.msg", reason="not part of the ROS wheels").TFMessage
    arguments = params("publish_period_s:=0.1", "score.trajectory.conditions:=['distance=1']")
    positions, quats = turning_drive(41)
    shift = Transform(matrix_from_quat(np.array([0.0, 0.0, 0.6, 0.8])), np.array([3.0, -2.0, 0.5]))
    with (
        Manager("monitor_node") as peer,
        LocalNode(peer, capfd, MonitorNode, *arguments, *params("truth.frame:=map:base")),
    ):
        report = peer.listen(String, "metrics/report", latched=True)
        for k in range(41):
            stamp_ns, pose = START_NS + k * 10**8, Transform.from_quat(positions[k], quats[k])
            message = bag_messages.odometry(stamp_ns, positions[k], quats[k])
            peer.publish(Odometry, "localisation/odometry", raw(message))
            edges = [("odom", "base", shift.inverse() @ pose)] + [("map", "odom", shift)] * (k % 2 == 0)
            for parent, child, edge in edges:
                header = header_msg(stamp_ns, parent)
                moved = transform_msg(header, child, pose_msg(edge, edge.file_quat_xyzw))
                peer.publish(kind, "/tf", kind(transforms=[moved]))
        peer.until(lambda: association_of(report).get("matched") == 41, "the report of the whole drive")
        error = row(json.loads(report[-1].data), "position")
        assert error["n"] > 0
        assert error["max"] < 1e-6
