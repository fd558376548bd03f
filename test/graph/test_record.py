"""Recording of a topic whose publishers change."""

import time
from pathlib import Path
from threading import Event, Thread

import rclpy
from rclpy.context import Context
from std_msgs.msg import String

from sfr_loc_map.graph.record import RecordOptions, record

TOPIC = "/bookmark"


def publish(done: Event) -> None:
    """Publish with one publisher, then alternately with a second one that starts to number its messages at 1."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("talker", context=context)
    publishers = [node.create_publisher(String, TOPIC, 100)]
    for number in range(1000):
        publishers[number % len(publishers)].publish(String())
        if number == 100:
            publishers.append(node.create_publisher(String, TOPIC, 100))
        if done.wait(0.02):
            break
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def test_messages_of_a_second_publisher_are_no_losses(tmp_path: Path) -> None:
    done = Event()
    talker = Thread(target=publish, args=(done,))
    talker.start()
    try:
        time.sleep(0.5)
        counts = record(tmp_path / "bag", RecordOptions((TOPIC,), duration_s=5.0), print)
    finally:
        done.set()
        talker.join()
    assert counts[TOPIC].count > 110, "the second publisher was recorded"
    assert counts[TOPIC].lost == 0
