"""The feed of the live page: it shows images of each transport that the nodes accept."""

from __future__ import annotations

import time

import cv2
import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.errors import InputError
from sfr_loc_map.live.feed import RosFeed, lost_by_topic
from sfr_loc_map.live.page_process import connected_nodes_topic
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.tracked_images import TrackedImages
from sfr_loc_map.live.updates import ImageSample
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_types import Level
from sfr_loc_map.ros.image_messages import image_msg
from sfr_loc_map.ros.messages import header_msg, message_type
from sfr_loc_map.ros.qos import LATCHED
from sfr_loc_map.ros.statuses import status_msg
from sfr_loc_map.topics import DIAGNOSTICS, ESTIMATE, IMAGES

PIXELS = np.arange(64 * 48, dtype=np.uint16).reshape(48, 64).astype(np.uint8)


@pytest.mark.parametrize("name", IMAGES)
def test_an_image_of_each_transport_is_shown(own_domain: None, name: str) -> None:
    state = LiveState()
    state.watch("test", is_watching=True)
    with RosFeed(state) as feed:
        node = rclpy.create_node("camera")
        kind = message_type(IMAGES[name])
        publisher = node.create_publisher(kind, f"loc/left/{name}", QoSProfile(depth=1))
        deadline = time.monotonic() + 60.0
        stamp_ns = NS_PER_S
        while "loc/left" not in state.media and time.monotonic() < deadline:
            stamp_ns += NS_PER_S
            header = header_msg(stamp_ns, "camera")
            message = image_msg(PIXELS, "mono8", header)
            if kind is CompressedImage:
                data = cv2.imencode(".png", PIXELS)[1].tobytes()
                message = CompressedImage(header=header, format="mono8; png compressed", data=data)
            publisher.publish(message)
            time.sleep(0.1)
        node.destroy_node()
        assert feed is not None
    assert state.media["loc/left"].full_size == (64, 48)


def test_both_images_of_a_pair_are_shown_if_their_stamps_differ_within_the_tolerance(own_domain: None) -> None:
    state = LiveState()
    state.watch("test", is_watching=True)
    with RosFeed(state):
        node = rclpy.create_node("camera")
        late_ns = {"loc/left": 0, "loc/right": 1_000_000}
        publishers = {name: node.create_publisher(Image, f"{name}/image_rect", QoSProfile(depth=1)) for name in late_ns}
        deadline = time.monotonic() + 60.0
        stamp_ns = NS_PER_S
        while not late_ns.keys() <= state.media.keys() and time.monotonic() < deadline:
            stamp_ns += NS_PER_S // 5
            for name, late in late_ns.items():
                publishers[name].publish(image_msg(PIXELS, "mono8", header_msg(stamp_ns + late, "camera")))
            time.sleep(0.2)
        node.destroy_node()
    assert late_ns.keys() <= state.media.keys()


def test_a_camera_that_changes_to_another_transport_is_followed(own_domain: None) -> None:
    state = LiveState()
    state.watch("test", is_watching=True)
    with RosFeed(state):
        for topic in ("/loc/left/image_rect", "/loc/left/image_rect/compressed"):
            node = rclpy.create_node("camera")
            kind = CompressedImage if topic.endswith("compressed") else Image
            node.create_publisher(kind, topic, QoSProfile(depth=1))
            deadline = time.monotonic() + 30.0
            awaited = f"{topic} has a publisher"
            while awaited not in state.image_problems.get("loc/left", "") and time.monotonic() < deadline:
                time.sleep(0.1)
            assert awaited in state.image_problems["loc/left"]
            node.destroy_node()


def test_a_node_is_connected_once_its_status_is_received_and_its_last_service_is_discovered(own_domain: None) -> None:
    with RosFeed(LiveState()) as feed:
        node, executor = rclpy.create_node("monitor_node"), SingleThreadedExecutor()
        executor.add_node(node)
        connected: list[str] = []
        topic = connected_nodes_topic(feed.ros_node.get_name())
        node.create_subscription(String, topic, lambda message: connected.append(message.data), LATCHED)
        statuses = node.create_publisher(DiagnosticArray, DIAGNOSTICS, QoSProfile(depth=10))
        status = status_msg("monitor_node: health", Level.OK, "", {})

        def is_connected_within(seconds: float) -> bool:
            deadline = time.monotonic() + seconds
            while not connected and time.monotonic() < deadline:
                statuses.publish(DiagnosticArray(status=[status]))
                executor.spin_once(timeout_sec=0.1)
            return connected == ["monitor_node"]

        assert not is_connected_within(3.0)
        node.create_service(Trigger, "~/reset", lambda _, response: response)
        assert is_connected_within(60.0)
        node.destroy_node()


def test_tracks_are_shown_with_the_right_image_of_their_pair() -> None:
    shown: list[ImageSample] = []
    images = TrackedImages(shown.append)
    images.add_tracks(0, np.zeros((0, 5), np.float32))  # images now wait for their tracks
    for stamp_ns in (NS_PER_S, 2 * NS_PER_S):
        images.add_image("loc/left", stamp_ns, PIXELS, 0.0)
        images.add_image("loc/right", stamp_ns + 1_000_000, PIXELS, 0.0)
    assert not shown
    images.add_tracks(2 * NS_PER_S, np.zeros((0, 5), np.float32))
    expected = [("loc/left", 2 * NS_PER_S), ("loc/right", 2 * NS_PER_S + 1_000_000)]
    assert [(sample.topic, sample.stamp_ns) for sample in shown] == expected


@pytest.mark.parametrize("error", [InputError("an invalid cloud"), KeyError("a defect")], ids=["invalid", "defect"])
def test_an_exception_of_a_map_is_logged_unless_the_message_is_invalid(
    own_domain: None, capfd: pytest.CaptureFixture[str], error: Exception
) -> None:
    def fail() -> None:
        raise error

    with RosFeed(LiveState()) as feed:
        feed._map_worker.enqueue(fail)
        feed._map_worker.wait_idle()
    assert ("live: KeyError('a defect')" in capfd.readouterr().err) == isinstance(error, KeyError)


def test_the_losses_of_all_transports_of_a_camera_are_added() -> None:
    losses = {"loc/left/image_rect": 1, "loc/left/image_rect/compressed": 2, "loc/right/image_raw": 4, ESTIMATE: 8}
    assert lost_by_topic(losses) == {"loc/left": 3, "loc/right": 4, ESTIMATE: 8}
