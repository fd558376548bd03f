"""A node with its default parameters among programs that know nothing of it: cameras, tools, a second node."""

# ruff: noqa: E402 - ROS may be absent
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

import rclpy
from made_scene import LOC_RIG, T_RB_LOCSB, loc_pair
from peers import Capture, LocalNode, Manager
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy, qos_profile_sensor_data
from scenes import MOUNT, RELIABLE, raw
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes.diagnostics import Level, values_of
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.mapping_node import MappingNode
from sfr_loc_map.nodes.monitor_node import MonitorNode

DEFAULTS = ["--ros-args", *MOUNT[len(RELIABLE) :]]
MOUNTED = [
    Parameter("T_rb_locsb.translation_m", value=T_RB_LOCSB.translation.tolist()),
    Parameter("T_rb_locsb.quat_xyzw", value=T_RB_LOCSB.file_quat_xyzw.tolist()),
]
CALLS_AT_ONCE = 40
"""What comes at 57 Hz within a call of 0.7 s."""


class Camera:
    """A camera driver with the quality of service that drivers have: best effort."""

    def __init__(self, peer: Manager) -> None:
        self.publishers: dict[str, Any] = {}
        for side in ("left", "right"):
            for kind, name in ((CameraInfo, "camera_info"), (Image, "image_rect")):
                topic = f"loc/{side}/{name}"
                self.publishers[topic] = peer.node.create_publisher(kind, topic, qos_profile_sensor_data)
        peer.until(lambda: all(p.get_subscription_count() for p in self.publishers.values()), "the node's listeners")

    def send(self, index: int) -> None:
        pair = loc_pair(index)
        for side in ("left", "right"):
            info = bag_messages.camera_info(pair.stamp_ns, LOC_RIG, "loc", side)
            self.publishers[f"loc/{side}/camera_info"].publish(raw(info))
        for side, pixels in (("left", pair.left), ("right", pair.right)):
            image = bag_messages.image(pair.stamp_ns, pixels, "loc", side)
            self.publishers[f"loc/{side}/image_rect"].publish(raw(image))


def test_a_node_at_its_defaults_serves_what_is_around_it(ros: None, capfd: Capture) -> None:
    arguments = [*DEFAULTS, "-p", "health.period_s:=0.1"]
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *arguments) as node:
        overlays = peer.listen(Image, "localisation/debug_image")
        camera = Camera(peer)
        for index in range(2):  # the first makes the rig known
            camera.send(index)
        peer.until(lambda: len(peer.odometry) == 2 and overlays, "odometry of best-effort images")
        left_frame = bag_messages.camera_info(0, LOC_RIG, "loc", "left").header.frame_id
        assert overlays[0].header.frame_id == left_frame != ""
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


def test_parameters_are_open_until_the_node_is_configured(ros: None, tmp_path: Path) -> None:
    node = LocalisationNode(parameter_overrides=[*MOUNTED, Parameter("autostart", value=False)])

    def change(name: str, value: Any) -> str:
        return str(node.set_parameters([Parameter(name, value=value)])[0].reason)

    for name, value in (("queue_size", 3), ("output_reliability", "best_effort"), ("rb_frame", "base_link")):
        assert change(name, value) == ""
    assert change("health.period_s", 0.5) == ""
    assert "must lie in 1 .. 1000" in change("queue_size", 0) or "out of range" in change("queue_size", 0)
    assert "read-only" in change("autostart", True)
    assert "mask '/nowhere.png': No such file" in change("localisation.left_mask", "/nowhere.png")
    node.trigger_configure()
    assert node.config.queue()[1] == 3
    (odometry,) = node.get_publishers_info_by_topic("/localisation/odometry")
    assert odometry.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert "'queue_size' is read-only while the node is inactive: deactivate and clean it up" in change("queue_size", 5)
    assert change("localisation.max_features", 300) == ""
    node.trigger_cleanup()
    assert change("queue_size", 5) == ""
    node.destroy_node()


def test_a_file_that_is_gone_is_named_when_the_node_is_configured(ros: None, tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), loc_pair(0).left)
    file = Parameter("localisation.right_mask", value=str(mask))
    node = LocalisationNode(parameter_overrides=[*MOUNTED, file])
    mask.unlink()
    with pytest.raises(ConfigError, match="No such file"):
        node.start()
    node.destroy_node()
    with pytest.raises(ConfigError, match="No such file"):
        LocalisationNode(parameter_overrides=[*MOUNTED, file])


@pytest.mark.parametrize("kind", [LocalisationNode, MappingNode, MonitorNode])
def test_a_clock_that_ros_would_ignore_is_refused(ros: None, kind: type[LocalisationNode]) -> None:
    with pytest.raises(ConfigError, match="'use_sim_time' to '1' of type 'INTEGER', expecting type 'BOOL'"):
        kind(cli_args=["--ros-args", "-p", "use_sim_time:=1"], use_global_arguments=False)


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
