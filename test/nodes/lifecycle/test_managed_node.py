"""The states of a managed node, its live parameters, its queue and its quality of service."""

# ruff: noqa: E402 - ROS may be absent
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

import rclpy
from lifecycle_msgs.msg import Transition
from made_scene import LOC_RIG, loc_pair, true_pose
from peers import Capture, LocalNode, Manager
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from scenes import MOUNT, RELIABLE, calls, raw, send_infos, send_pair
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.nodes.diagnostics import Level, values_of
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.mapping_node import MappingNode
from sfr_loc_map.nodes.messages.pose import odometry_row
from sfr_loc_map.nodes.monitor_node import MonitorNode
from sfr_loc_map.nodes.stereo_input import ReceivedPair

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = (
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE,
)
ARGUMENTS = ("--ros-args", *MOUNT)
CALLS_AT_ONCE = 40
"""What comes at 57 Hz within a call of 0.7 s."""


@pytest.mark.slow
def test_a_node_goes_through_its_states_and_receives_only_when_active(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *ARGUMENTS, "-p", "autostart:=false") as node:
        assert peer.state() == "unconfigured"
        assert peer.change(ACTIVATE) == (False, "unconfigured")  # there is no such step from here
        assert peer.node.count_publishers("localisation/odometry") == 0
        assert values_of(peer.well(Level.OK, "unconfigured"))["lifecycle"] == "unconfigured"
        assert peer.change(CONFIGURE) == (True, "inactive")
        peer.until(lambda: peer.node.count_publishers("localisation/odometry") == 1, "the publisher")
        assert peer.node.count_subscribers("loc/left/image_rect") == 0
        assert peer.change(ACTIVATE) == (True, "active")
        assert peer.change(CONFIGURE) == (False, "active")
        send_infos(peer, "loc", LOC_RIG)
        first = peer.play(0), peer.play(1)
        assert peer.change(DEACTIVATE) == (True, "inactive")
        peer.until(lambda: peer.node.count_subscribers("loc/left/image_rect") == 0, "no listener")
        assert not peer.call("localisation_node/reset").success
        assert peer.change(ACTIVATE) == (True, "active")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(2)  # goes on where it was: no start at the origin
        localiser = Localiser(LOC_RIG, LocalisationConfig(), Transform.identity())
        expected = [tuple(localiser.process(loc_pair(index)).T_ds_rb.translation) for index in range(3)]
        assert [*first, odometry_row(peer.odometry[-1])[1]] == expected
        assert peer.change(DEACTIVATE) == (True, "inactive")
        assert peer.change(CLEANUP) == (True, "unconfigured")
        peer.until(lambda: peer.node.count_publishers("localisation/odometry") == 0, "no publisher")
        assert peer.change(CONFIGURE) == (True, "inactive")
        assert peer.change(ACTIVATE) == (True, "active")
        send_infos(peer, "loc", LOC_RIG)
        assert peer.play(3) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)  # nothing is left of before
        assert peer.change(Transition.TRANSITION_ACTIVE_SHUTDOWN) == (True, "finalized")
        assert "Traceback" not in node.text


def test_a_transition_that_fails_is_named_and_can_be_tried_again(ros: None, capfd: Capture, tmp_path: Path) -> None:
    limits, precious = tmp_path / "limits.yaml", tmp_path / "thesis"
    (precious / "chapter").mkdir(parents=True)
    arguments = ["--ros-args", "-p", "autostart:=false", "-p", f"limits_file:={limits}"]
    arguments += ["-p", f"save_file:={precious}", "-p", "save_period_s:=1.0"]
    with Manager("monitor_node") as peer, LocalNode(peer, capfd, MonitorNode, *arguments) as node:
        assert peer.change(CONFIGURE) == (False, "unconfigured")
        assert "configure failed: cannot read" in node.text
        peer.well(Level.ERROR, "configure failed: cannot read")
        limits.write_text("timing:\n  localisation_p95_s: 1.0\n", encoding="utf-8")
        assert peer.change(CONFIGURE) == (False, "unconfigured")
        assert "a folder that is not empty is there" in node.text
        assert (precious / "chapter").is_dir()
        (precious / "chapter").rmdir()
        precious.rmdir()
        assert peer.change(CONFIGURE) == (True, "inactive")
        assert peer.change(ACTIVATE) == (True, "active")


def test_parameters_change_live_as_a_whole_or_not_at_all(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *ARGUMENTS):
        configurations = peer.listen(String, "localisation/configuration", latched=True)
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        at = peer.play(1)
        ok, reason = peer.set(localisation__max_features=300, localisation__min_tracked=7)
        assert (ok, "min_tracked" in reason) == (False, True)
        ok, reason = peer.set(localisation__motion__max_turn_rad_s=math.inf)
        assert (ok, "range" in reason) == (False, True)
        ok, reason = peer.set(queue_size=7)
        assert (ok, "read-only" in reason) == (False, True)
        assert peer.set(localisation__max_features=300, localisation__min_tracked=20) == (True, "")

        def adopted() -> bool:
            values = json.loads(configurations[-1].data)
            return (values["localisation.max_features"], values["localisation.min_tracked"]) == (300, 20)

        peer.until(adopted, "the configuration")
        before = np.array(peer.odometry[-1].pose.covariance).reshape(6, 6)
        assert peer.play(2) == pytest.approx(at, abs=1e-12)  # restarts at its last pose
        step = np.linalg.norm(true_pose(1).translation - true_pose(0).translation)
        after = np.array(peer.odometry[-1].pose.covariance).reshape(6, 6)
        # which it knows no better than before, and the rover has gone on by a step meanwhile
        assert np.linalg.eigvalsh(after - before - 0.8 * np.diag([step**2] * 3 + [0] * 3)).min() > -1e-12
        localiser = Localiser(LOC_RIG, LocalisationConfig(max_features=300, min_tracked=20), Transform.identity())
        features = [localiser.process(loc_pair(index)).statistics.features for index in (2, 3)]
        peer.play(3)
        found = [float(values_of(status)["statistic.features"]) for status in calls(peer.diagnostics)[-2:]]
        assert found == features


def test_parameters_are_open_until_the_node_is_configured(ros: None, tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), loc_pair(0).left)
    node = LocalisationNode(cli_args=[*ARGUMENTS, "-p", "autostart:=false"])

    def change(name: str, value: Any) -> str:
        return str(node.set_parameters([Parameter(name, value=value)])[0].reason)

    for name, value in (("queue_size", 3), ("output_reliability", "best_effort"), ("rb_frame", "base_link")):
        assert change(name, value) == ""
    assert change("health.period_s", 0.5) == ""
    assert "must lie in 1 .. 1000" in change("queue_size", 0) or "out of range" in change("queue_size", 0)
    assert "read-only" in change("autostart", True)
    assert "mask '/nowhere.png': No such file" in change("localisation.left_mask", "/nowhere.png")
    assert change("localisation.right_mask", str(mask)) == ""
    mask.unlink()  # a file that is gone is named when the node is configured
    assert node.trigger_configure().name == "FAILURE"
    assert change("localisation.right_mask", "") == ""
    node.trigger_configure()
    assert node.config.queue()[1] == 3
    (odometry,) = node.get_publishers_info_by_topic("/localisation/odometry")
    assert odometry.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert "'queue_size' is read-only while the node is inactive: deactivate and clean it up" in change("queue_size", 5)
    assert change("localisation.max_features", 300) == ""
    node.trigger_cleanup()
    assert change("queue_size", 5) == ""
    node.destroy_node()


def test_what_comes_too_fast_is_dropped_by_the_rule_and_counted(ros: None, capfd: Capture) -> None:
    arguments = (*ARGUMENTS, "-p", "overload:=newest_first", "-p", "input.queue_depth:=100")
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *arguments):
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        for index in range(1, 21):  # nobody receives meanwhile
            send_pair(peer, "loc", loc_pair(index))
        peer.until(lambda: peer.last_call() == loc_pair(20).stamp_ns, "the newest pair")
        stamps = [int(values_of(status)["stamp_ns"]) for status in calls(peer.diagnostics)]
        assert stamps == sorted(stamps)
        values = peer.last_values()
        dropped = int(values["dropped_overload"])
        lost = int(values["dropped_in_transport"]) + int(values["dropped_unpaired"])
        assert dropped > 0
        assert dropped + lost / 2 == 21 - len(stamps)
        peer.well(Level.WARN, "dropped_overload")


class Slow(LocalisationNode):
    """Works for half a second on each pair; has a fault at its third."""

    begun = 0

    def _process(self, received: ReceivedPair) -> None:
        self.begun += 1
        time.sleep(0.5)
        assert self.begun != 3, "a third"
        super()._process(received)


@pytest.mark.slow
def test_the_node_answers_while_a_pair_is_worked_on_and_survives_a_fault(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, Slow, *ARGUMENTS) as node:
        send_infos(peer, "loc", LOC_RIG)
        peer.state()  # the service is known now
        for index in (0, 1):
            send_pair(peer, "loc", loc_pair(index))
        peer.until(lambda: node.node.begun, "work")
        assert peer.state() == "active"
        assert peer.set(localisation__max_features=300) == (True, "")
        assert (node.node.begun, len(peer.odometry)) == (1, 0)
        # what is under way is finished and published, what waits is not begun
        assert peer.change(DEACTIVATE) == (True, "inactive")
        peer.until(lambda: peer.odometry, "the result of the pair under way")
        peer.spin(0.3)
        assert (node.node.begun, len(peer.odometry)) == (1, 1)
        assert peer.change(ACTIVATE) == (True, "active")
        send_infos(peer, "loc", LOC_RIG)
        at = peer.play(2)
        send_pair(peer, "loc", loc_pair(3))
        peer.well(Level.ERROR, "internal fault, localisation restarts: AssertionError: a third")
        assert "Traceback" in node.text
        assert peer.play(4) == pytest.approx(at, abs=1e-12)
        assert int(peer.last_values()["dropped_rejected"]) == 1


def test_a_node_at_its_defaults_serves_best_effort_cameras_and_says_what_is_lost(ros: None, capfd: Capture) -> None:
    arguments = ["--ros-args", *MOUNT[len(RELIABLE) :], "-p", "health.period_s:=0.1"]
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *arguments) as node:
        overlays = peer.listen(Image, "localisation/debug_image")
        camera = {
            f"loc/{side}/{name}": peer.node.create_publisher(kind, f"loc/{side}/{name}", qos_profile_sensor_data)
            for side in SIDES
            for kind, name in ((CameraInfo, "camera_info"), (Image, "image_rect"))
        }
        peer.until(lambda: all(p.get_subscription_count() for p in camera.values()), "the node's listeners")
        for pair in (loc_pair(0), loc_pair(1)):  # the first makes the rig known
            for side, pixels in zip(SIDES, (pair.left, pair.right), strict=True):
                info = bag_messages.camera_info(pair.stamp_ns, LOC_RIG, "loc", side)
                camera[f"loc/{side}/camera_info"].publish(raw(info))
                image = bag_messages.image(pair.stamp_ns, pixels, "loc", side)
                camera[f"loc/{side}/image_rect"].publish(raw(image))
        peer.until(lambda: len(peer.odometry) == 2 and overlays, "odometry of best-effort images")
        frame = bag_messages.camera_info(0, LOC_RIG, "loc", "left").header.frame_id
        assert overlays[0].header.frame_id == frame != ""
        assert "offers less" not in node.text
        status = peer.until(lambda: [s for s in peer.health() if s.message == "tracking"], "health")[-1]
        assert status.hardware_id
        assert 0.0 < float(values_of(status)["received_messages_hz"]) < 100.0

        (images,) = (item for item in node.node.subscriptions if item.topic_name == "/loc/left/image_rect")
        for number in range(1, 50, 2):  # a driver with too little shared memory
            images.callback(Image(), {"publication_sequence_number": number})
        peer.well(Level.WARN, "% of the images of 'loc' are lost in transport: start the process that publishes them")

        client = peer.node.create_client(Trigger, "localisation_node/reset")
        peer.until(client.service_is_ready, "the service")
        node.node.worker.enqueue(lambda: time.sleep(0.3))
        answers = [client.call_async(Trigger.Request()) for _ in range(CALLS_AT_ONCE)]
        peer.until(lambda: all(answer.done() for answer in answers), "all answers", 5.0)

        second = rclpy.create_node("localisation_node")
        peer.well(Level.WARN, "another node of the name /localisation_node is in this ROS domain")
        second.destroy_node()


def test_quality_of_service_that_does_not_fit_is_named(ros: None, capfd: Capture) -> None:
    arguments = (*ARGUMENTS, "-p", "output_reliability:=best_effort")
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *arguments):
        peer.well(Level.WARN, "a subscriber of /localisation/odometry requests more RELIABILITY than this node offers")
        best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        peer.node.create_publisher(Image, "loc/left/image_rect", best_effort)
        peer.well(Level.WARN, "a publisher of /loc/left/image_rect offers less RELIABILITY than this node requests")


def test_every_subscription_may_be_set_on_its_own(ros: None, capfd: Capture) -> None:
    name = "qos_overrides./{}.subscription.{}"
    given = {
        name.format("localisation/odometry", "reliability"): "best_effort",
        name.format("nav/pose", "reliability"): "reliable",
        name.format("mapping/points", "durability"): "transient_local",
        name.format("mapping/pionts", "reliability"): "best_effort",
    }
    node = MonitorNode(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    node.start()
    wanted = {
        "localisation/odometry": ("BEST_EFFORT", "VOLATILE"),
        "ground_truth/odometry": ("BEST_EFFORT", "VOLATILE"),
        "nav/left/camera_info": ("BEST_EFFORT", "VOLATILE"),
        "nav/pose": ("RELIABLE", "VOLATILE"),
        "mapping/points": ("RELIABLE", "TRANSIENT_LOCAL"),
    }
    for topic, policies in wanted.items():
        (info,) = node.get_subscriptions_info_by_topic(f"/{topic}")
        assert (info.qos_profile.reliability.name, info.qos_profile.durability.name) == policies, topic
    assert "mapping/pionts.subscription.reliability is of no subscription" in capfd.readouterr().err
    node.destroy_node()
    wrong = [Parameter(name.format("nav/pose", "reliability"), value="besteffort")]
    node = MappingNode(parameter_overrides=wrong)
    with pytest.raises(ConfigError, match="must be one of reliable, best_effort"):
        node.start()
    node.destroy_node()


def test_a_clock_that_ros_would_ignore_is_refused(ros: None) -> None:
    with pytest.raises(ConfigError, match="'use_sim_time' to '1' of type 'INTEGER', expecting type 'BOOL'"):
        MonitorNode(cli_args=["--ros-args", "-p", "use_sim_time:=1"], use_global_arguments=False)
