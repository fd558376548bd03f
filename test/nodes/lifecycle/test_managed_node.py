"""The states of a managed node, its live parameters, its queue and its quality of service."""

import json
import math
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from rclpy.lifecycle import LifecyclePublisher
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import String

from helpers.made_scene import LOC_RIG, loc_pair, true_pose
from helpers.manager import Capture, LocalNode, Manager, localised
from helpers.node_scenes import MOUNT, RELIABLE, calls, params, send_infos, send_pair
from sfr_loc_map.errors import InputError
from sfr_loc_map.message_types import Level
from sfr_loc_map.nodes.localisation_node import LocalisationNode, LocalisationNodeConfig
from sfr_loc_map.nodes.monitor_node import MonitorNode
from sfr_loc_map.nodes.stereo.stereo_input import ReceivedPair
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.pose_messages import covariance_of
from sfr_loc_map.ros.statuses import values_of

CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE


def publish_unheard(peer: Manager) -> None:
    """Publish images to which nobody listens."""
    for topic, publisher in peer._publishers.items():
        if topic.endswith("image_rect"):
            for _ in range(5):
                publisher.publish(Image())


def test_a_node_goes_through_its_states_and_receives_only_when_active(ros: None, capfd: Capture) -> None:
    waits = params("autostart:=false")
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *waits) as node:

        def ends(count: int) -> None:
            """Wait for so many publishers of results and subscriptions to images."""
            names = "localisation/odometry", "loc/left/image_rect"
            node = peer.node
            peer.until(lambda: node.count_publishers(names[0]) + node.count_subscribers(names[1]) == count, "ends")

        assert peer.state() == "unconfigured"
        assert peer.change(ACTIVATE) == (False, "unconfigured")  # there is no such step from here
        ends(0)
        assert values_of(peer.well(Level.OK, "unconfigured"))["lifecycle"] == "unconfigured"
        assert "read-only" in peer.set(autostart=True)
        assert "mask '/nowhere.png': No such file" in peer.set(localisation__left_mask="/nowhere.png")
        assert peer.set(queue_size=3) == ""
        assert peer.change(CONFIGURE) == (True, "inactive")
        assert node.node.config.queue()[1] == 3
        assert "'queue_size' is read-only while the node is inactive: deactivate" in peer.set(queue_size=5)
        ends(1)
        assert peer.change(ACTIVATE) == (True, "active")
        ends(2)
        assert peer.change(CONFIGURE) == (False, "active")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        peer.play(1)
        assert peer.change(DEACTIVATE) == (True, "inactive")
        ends(1)
        assert not peer.call("localisation_node/reset").success
        publish_unheard(peer)
        assert peer.change(ACTIVATE) == (True, "active")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(2)  # goes on where it was: no start at the origin
        assert peer.last_values()["dropped_in_transport"] == "0"
        assert peer.positions() == localised([0, 1, 2])
        assert peer.change(DEACTIVATE) == (True, "inactive")
        assert peer.change(CLEANUP) == (True, "unconfigured")
        ends(0)
        assert peer.change(CONFIGURE) == (True, "inactive")
        assert peer.change(ACTIVATE) == (True, "active")
        send_infos(peer, "loc", LOC_RIG)
        assert peer.play(3) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)  # nothing is left of before
        assert peer.change(Transition.TRANSITION_ACTIVE_SHUTDOWN) == (True, "finalized")
        assert "Traceback" not in node.text


def test_a_transition_that_fails_is_named_and_can_be_tried_again(ros: None, capfd: Capture, tmp_path: Path) -> None:
    limits, precious = tmp_path / "limits.yaml", tmp_path / "thesis"
    (precious / "chapter").mkdir(parents=True)
    arguments = params("autostart:=false", f"limits_file:={limits}", f"save_file:={precious}", "save_period_s:=1.0")
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments) as node:
        assert peer.change(CONFIGURE) == (False, "unconfigured")
        peer.well(Level.ERROR, "configure failed: cannot read")
        limits.write_text("timing:\n  localisation_p95_s: 1.0\n", encoding="utf-8")
        assert peer.change(CONFIGURE) == (False, "unconfigured")
        assert "a folder that is not empty exists" in node.text
        (precious / "chapter").rmdir()
        precious.rmdir()
        assert peer.change(CONFIGURE) == (True, "inactive")
        assert peer.change(ACTIVATE) == (True, "active")


def test_parameters_change_live_as_a_whole_or_not_at_all(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT):
        configurations = peer.listen(String, "localisation/configuration", latched=True)
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        at = peer.play(1)
        assert "min_tracked" in peer.set(localisation__max_features=300, localisation__min_tracked=7)
        assert "range" in peer.set(localisation__motion__max_turn_rad_s=math.inf)
        assert "read-only" in peer.set(queue_size=7)
        assert peer.set(localisation__max_features=300, localisation__min_tracked=20) == ""

        def adopted() -> bool:
            values = json.loads(configurations[-1].data)
            return (values["localisation.max_features"], values["localisation.min_tracked"]) == (300, 20)

        peer.until(adopted, "the configuration")
        before = covariance_of(peer.odometry[-1])
        assert peer.play(2) == pytest.approx(at, abs=1e-12)  # restarts at its last pose
        step = np.linalg.norm(true_pose(1).translation - true_pose(0).translation)
        after = covariance_of(peer.odometry[-1])
        # which it knows no better than before, and the rover has gone on by a step meanwhile
        assert np.linalg.eigvalsh(after - before - 0.8 * np.diag([step**2] * 3 + [0] * 3)).min() > -1e-12
        moved = np.array(peer.play(3)) - at
        first, second = localised([2, 3], max_features=300, min_tracked=20)
        # in the frame of before, which is turned by a step
        assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(np.subtract(second, first)), abs=1e-9)


def test_what_comes_too_fast_is_dropped_by_the_rule_and_counted(ros: None, capfd: Capture) -> None:
    arguments = params("overload:=newest_first", "input.queue_depth:=100")
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *arguments) as node:
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        free = threading.Event()
        node.node.worker.enqueue(lambda: print(free.wait(30)))
        for index in range(1, 21):
            send_pair(peer, "loc", loc_pair(index))
        peer.until(lambda: node.node.worker.dropped, "overload")
        free.set()
        peer.until(lambda: peer.last_call() == loc_pair(20).stamp_ns, "the newest pair")
        stamps = [int(values_of(status)["stamp_ns"]) for status in calls(peer.diagnostics)]
        assert stamps == sorted(stamps)
        values = peer.last_values()
        dropped = int(values["dropped_overload"])
        lost = int(values["dropped_in_transport"]) + int(values["dropped_unpaired"])
        assert dropped + lost / 2 == 21 - len(stamps)
        peer.well(Level.WARN, "dropped_overload")


class Slow(LocalisationNode):
    """Works for a while on each pair; has a fault at its third."""

    begun = 0

    def _process(self, received: ReceivedPair) -> None:
        self.begun += 1
        time.sleep(0.3)
        assert self.begun != 3, "a third"
        super()._process(received)


def test_the_node_answers_while_a_pair_is_worked_on_and_survives_a_fault(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, Slow, *MOUNT) as node:
        send_infos(peer, "loc", LOC_RIG)
        peer.state()  # the services are known now
        peer.set()
        for index in (0, 1):
            send_pair(peer, "loc", loc_pair(index))
        peer.until(lambda: node.node.begun, "work")
        assert peer.state() == "active"
        assert peer.set(localisation__max_features=300) == ""
        assert (node.node.begun, len(peer.odometry)) == (1, 0)
        # what is under way is finished and published, what waits is not begun
        assert peer.change(DEACTIVATE) == (True, "inactive")
        peer.until(lambda: peer.odometry, "the result of the pair under way")
        peer.spin(0.2)
        assert (node.node.begun, len(peer.odometry)) == (1, 1)
        assert peer.change(ACTIVATE) == (True, "active")
        send_infos(peer, "loc", LOC_RIG)
        at = peer.play(2)
        send_pair(peer, "loc", loc_pair(3))
        fault = "internal fault, localisation continues: AssertionError: a third"
        peer.well(Level.ERROR, fault)
        statuses = [status for array in peer.diagnostics for status in array.status]
        (found,) = [status for status in statuses if status.name == "localisation_node: fault"]
        assert found.message.startswith(fault)
        assert not [status for status in statuses if status.name == "localisation_node: input"]
        assert "Traceback" in node.text
        assert peer.play(4) == pytest.approx(at, abs=1e-12)
        assert int(peer.last_values()["dropped_rejected"]) == 1


def test_an_exception_of_a_callback_is_reported_and_does_not_end_the_node(ros: None, capfd: Capture) -> None:
    errors = [InputError("a message that cannot be used"), ValueError("a defect")]

    def fail(message: String) -> None:
        raise errors[int(message.data)]

    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT) as node:
        node.node.endpoints.add_subscription(String, "failing", fail, QoSProfile(depth=10))
        peer.publish(String, "failing", String(data="0"))
        peer.refused("a message that cannot be used")
        peer.publish(String, "failing", String(data="1"))
        peer.well(Level.ERROR, "internal fault, localisation continues: ValueError: a defect")
        send_infos(peer, "loc", LOC_RIG)
        assert peer.play(0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


class FailsAtParameters(LocalisationNode):
    """Raises an exception when a parameter is checked or applied, and before a service is executed."""

    def check_config(self, config: LocalisationNodeConfig) -> None:
        super().check_config(config)
        if config.localisation.max_features == 301:
            raise ValueError("a defect of the check")

    def apply_config(self, config: LocalisationNodeConfig) -> None:
        raise ValueError("a defect of the change")

    def subscribe(self) -> None:
        super().subscribe()
        self.add_service("~/failing", lambda: "done", first=self.fail)

    def fail(self) -> None:
        raise ValueError("a defect of the service")


def test_an_exception_of_a_parameter_or_service_callback_does_not_end_the_node(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, FailsAtParameters, *MOUNT) as node:
        assert "a defect of the check" in peer.set(localisation__max_features=301)
        assert peer.set(localisation__max_features=302) == ""
        peer.well(Level.ERROR, "internal fault, localisation continues: ValueError: a defect of the change")
        answer = peer.call("localisation_node/failing")
        assert (answer.success, answer.message) == (False, "localisation failed: see the log")
        peer.well(Level.ERROR, "internal fault, localisation continues: ValueError: a defect of the service")
        assert node.text.count("Traceback") == 3
        send_infos(peer, "loc", LOC_RIG)
        assert peer.play(0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


class FailsAtActivation(LocalisationNode):
    """Refuses to be activated."""

    def subscribe(self) -> None:
        super().subscribe()
        raise InputError("a refusal")


def test_nothing_is_received_or_published_after_a_failed_activation(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, FailsAtActivation, *params("autostart:=false")) as node:
        assert peer.change(CONFIGURE) == (True, "inactive")
        assert peer.change(ACTIVATE) == (False, "inactive")
        outputs = [item for item in node.node.publishers if isinstance(item, LifecyclePublisher)]
        assert [item.is_activated for item in outputs] == [False] * len(outputs) != []
        peer.until(lambda: not peer.node.count_subscribers("loc/left/image_rect"), "the end of the subscription")


class FailsAtHealth(LocalisationNode):
    """Raises an exception when its health is published."""

    def expects_input(self) -> bool:
        if self.state == "active":
            raise ValueError("a defect of the health")
        return True


def test_an_exception_of_the_health_timer_does_not_end_the_node(ros: None, capfd: Capture) -> None:
    arguments = params("health.period_s:=0.1")
    with Manager() as peer, LocalNode(peer, capfd, FailsAtHealth, *MOUNT, *arguments) as node:
        node.wait_for("ValueError: a defect of the health")
        assert peer.state() == "active"


class FailsAtJump(LocalisationNode):
    """Raises an exception when its clock is set back."""

    def clock_jumped_back(self) -> None:
        raise ValueError("a defect")


def test_an_exception_at_a_jump_of_the_clock_is_reported_and_does_not_end_the_node(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, FailsAtJump, *MOUNT, *params("use_sim_time:=true")):
        for stamp_ns in (loc_pair(50).stamp_ns, loc_pair(0).stamp_ns):
            peer.publish(Clock, "/clock", Clock(clock=header_msg(stamp_ns, "").stamp), arrival=True)
            peer.spin(0.1)
        peer.well(Level.ERROR, "internal fault, localisation continues: ValueError: a defect")
        send_infos(peer, "loc", LOC_RIG)
        assert peer.play(0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_a_node_at_its_defaults_serves_best_effort_cameras_and_says_what_is_lost(ros: None, capfd: Capture) -> None:
    arguments = [*MOUNT[len(RELIABLE) :], *params("health.period_s:=0.1")]
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *arguments) as node:
        peer.qos = qos_profile_sensor_data
        for index in (0, 1):
            send_infos(peer, "loc", LOC_RIG)
            send_pair(peer, "loc", loc_pair(index))
        peer.until(lambda: len(peer.odometry) == 2, "odometry of best-effort images")
        assert "offers weaker" not in node.text
        assert 0.0 < float(values_of(peer.well(Level.OK, "tracking"))["received_messages_hz"]) < 100.0

        (images,) = (item for item in node.node.subscriptions if item.topic_name == "/loc/left/image_rect")
        for number in range(1, 50, 2):  # a driver with too little shared memory
            images.callback(Image(), {"publication_sequence_number": number})
        peer.well(Level.WARN, "% of the images of 'loc' are lost in transport: start the process that publishes them")

        second = rclpy.create_node("localisation_node")
        peer.well(Level.WARN, "another node named /localisation_node publishes in this ROS domain")
        second.destroy_node()


def test_quality_of_service_that_does_not_fit_is_named(ros: None, capfd: Capture) -> None:
    arguments = params("output_reliability:=best_effort", "health.period_s:=0.1")
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *arguments):
        peer.well(Level.WARN, "a subscriber of /localisation/odometry requests stricter RELIABILITY")
        best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        peer.node.create_publisher(Image, "loc/left/image_rect", best_effort)
        peer.well(Level.WARN, "a publisher of /loc/left/image_rect offers weaker RELIABILITY than this node requests")
    topics = (f"/loc/{side}/{name}" for side in ("left", "right") for name in ("camera_info", "image_rect"))
    overrides = params(*(f"qos_overrides.{topic}.subscription.reliability:=best_effort" for topic in topics))
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *overrides):
        peer.qos = best_effort
        send_infos(peer, "loc", LOC_RIG)
        peer.spin(0.5)
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
