"""Recording of a topic whose publishers change."""

import time
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace

import pytest
import rclpy
from rclpy.context import Context
from sensor_msgs.msg import Image
from std_msgs.msg import String

from sfr_loc_map.errors import NodeError
from sfr_loc_map.graph import record as module
from sfr_loc_map.graph.record import RecordOptions, record
from sfr_loc_map.ros.peer import Peer

TOPIC = "/bookmark"


def publish(done: Event) -> None:
    """Publish with one publisher, then alternately with a second one that starts to number its messages at 1.

    Images are offered under a name that is not of the suite.
    """
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("talker", context=context)
    node.create_publisher(Image, "/zed/left/image_rect", 1)
    publishers = [node.create_publisher(String, TOPIC, 100)]
    for number in range(1000):
        publishers[number % len(publishers)].publish(String())
        if number == 100:
            publishers.append(node.create_publisher(String, TOPIC, 100))
        if done.wait(0.02):
            break
    node.destroy_node()
    rclpy.try_shutdown(context=context)


@pytest.mark.parametrize(("topics", "is_reported"), [((TOPIC,), False), ((), True)])
def test_messages_of_a_second_publisher_are_no_losses_and_images_of_other_names_are_reported(
    tmp_path: Path, own_domain: None, topics: tuple[str, ...], is_reported: bool
) -> None:
    said: list[str] = []
    done = Event()
    talker = Thread(target=publish, args=(done,))
    talker.start()
    try:
        time.sleep(0.5)
        counts = record(tmp_path / "bag", RecordOptions(topics, duration_s=5.0), said.append)
    finally:
        done.set()
        talker.join()
    assert counts[TOPIC].count > 110, "the second publisher was recorded"
    assert counts[TOPIC].lost == 0
    assert any("/zed/left/image_rect" in text for text in said) == is_reported


@pytest.mark.parametrize("duration_s", [0.1, 0.25, 0.6, 3.0])
def test_a_recording_ends_after_its_duration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own_domain: None, duration_s: float
) -> None:
    """By a clock that only waiting advances."""
    clock = SimpleNamespace(now_s=100.0)

    def spin(peer: Peer, seconds: float, until: object = None) -> bool:
        clock.now_s += seconds
        return False

    monkeypatch.setattr(Peer, "spin", spin)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    with pytest.raises(NodeError, match="no message was received"):
        record(tmp_path / "bag", RecordOptions((TOPIC,), duration_s=duration_s), print)
    assert clock.now_s - 100.0 == pytest.approx(duration_s)
