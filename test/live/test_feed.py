"""The feed of the live page: it shows images of each transport that the nodes accept."""

from __future__ import annotations

import time

import cv2
import numpy as np
import pytest
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CompressedImage

from sfr_loc_map.errors import InputError
from sfr_loc_map.live.feed import RosFeed
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import MediaKind
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.ros.messages import header_msg, image_msg, message_type
from sfr_loc_map.topics import IMAGES

PIXELS = np.arange(64 * 48, dtype=np.uint16).reshape(48, 64).astype(np.uint8)


@pytest.mark.parametrize("name", IMAGES)
def test_an_image_of_each_transport_is_shown(own_domain: None, name: str) -> None:
    state = LiveState()
    state.displayed.show("test", frozenset({MediaKind.IMAGES}))
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
