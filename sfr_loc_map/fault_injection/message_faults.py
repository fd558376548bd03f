"""Injected faults of messages: no malformed message may end, block or grow a node."""

from __future__ import annotations

import time
from collections.abc import Iterable
from functools import partial

from sensor_msgs.msg import Image

from sfr_loc_map.fault_injection import malformed_messages as malformed
from sfr_loc_map.fault_injection.fake_rover import IMAGE_DEPTH, MATCH_S
from sfr_loc_map.fault_injection.fault import Fault, Outcome
from sfr_loc_map.fault_injection.harness import LOCALISATION, MAPPING, MONITOR, Harness
from sfr_loc_map.fault_injection.malformed_messages import MalformedMessage

GROWTH_MB = 100.0
"""A message may not make a node grow by more than this."""
BURST_MESSAGES = 10
RATE_HZ = 10.0
TASK_OF_NODE = {LOCALISATION: "loc", MAPPING: "nav"}


def malformed_images(node: str, harness: Harness, outcome: Outcome) -> None:
    """Send images with wrong steps, sizes, encodings and data."""
    task, rover = TASK_OF_NODE[node], harness.rover
    pairs = malformed.images(task, rover.pair(task).left, rover.next_stamp)
    _inject(harness, outcome, node, [message for pair in pairs for message in pair])


def malformed_bytes(node: str, harness: Harness, outcome: Outcome) -> None:
    """Send images and camera_info that cannot be deserialised."""
    task, rover = TASK_OF_NODE[node], harness.rover
    messages = malformed.malformed_bytes(task, rover.pair(task), rover.rig(task))
    _inject(harness, outcome, node, messages, reported=False)


def malformed_camera_info(node: str, harness: Harness, outcome: Outcome) -> None:
    """Send impossible camera_info and invalid poses."""
    task, rover = TASK_OF_NODE[node], harness.rover
    infos = [info for pair in malformed.camera_infos(task, rover.next_stamp(), rover.rig(task)) for info in pair]
    poses = malformed.poses_for_localisation if task == "loc" else malformed.poses_for_mapping
    _inject(harness, outcome, node, [*infos, *poses(rover.next_stamp())])


def malformed_score_inputs(harness: Harness, outcome: Outcome) -> None:
    """Send the monitor invalid poses, calls, clouds and configurations."""
    _inject(harness, outcome, MONITOR, malformed.messages_for_monitor(harness.rover.next_stamp()))


def empty_message(harness: Harness, outcome: Outcome) -> None:
    """Send a zero-length message, by another publisher and by that of the camera.

    Fast DDS 2 does not deliver it, and a reliable reader then waits for it before it delivers later messages of the
    same writer, until it has left the writer's history. Other writers are not blocked.
    """
    topic = "loc/left/image_rect"
    harness.rover.publisher(Image, topic)
    other = harness.node.create_publisher(Image, topic, IMAGE_DEPTH)
    harness.wait_until(lambda: other.get_subscription_count() > 0, f"subscriber of {topic}")
    time.sleep(MATCH_S)
    other.publish(b"")
    harness.localise(3)
    outcome.observed.append("sent by another publisher it does not disturb the images of the camera")
    harness.node.destroy_publisher(other)
    first = harness.rover.next_stamp()
    harness.rover.publisher(Image, topic).publish(b"")
    begin = time.monotonic()
    with harness.rover.driving(RATE_HZ):
        harness.wait_poses(1)
        outcome.recover_s = time.monotonic() - begin
        time.sleep(1.0)
    harness.settle()
    pairs = harness.pairs_since(first)
    outcome.observed.append(f"sent by the camera it blocks the images of the camera, until {IMAGE_DEPTH} more are sent")
    outcome.lost = f"{pairs.missing} of {pairs.sent} pairs" if pairs.missing else "nothing"


def _work(harness: Harness, node: str) -> None:
    """Let a node process valid messages; pairs come as from a camera, so that one lost in the burst is not awaited."""
    if node == LOCALISATION:
        with harness.rover.driving(RATE_HZ):
            harness.wait_poses(2)
        harness.settle()
    elif node == MAPPING:
        harness.map()
    else:
        before = harness.received.scored_poses
        harness.localise()
        harness.wait_until(lambda: harness.received.scored_poses > before, "score of the pose")


def _inject(
    harness: Harness, outcome: Outcome, node: str, messages: Iterable[MalformedMessage], *, reported: bool = True
) -> None:
    """Publish messages; then the node must run, process valid ones, not have grown and have reported problems."""
    process, received = harness.nodes[node], harness.received
    pid, memory_before = process.popen.pid, harness.memory_mb(node)
    problems_before, text_before = len(received.problems), len(process.text)
    count = 0
    for item in messages:
        harness.rover.publish(item.kind, item.topic, item.message)
        count += 1
        if count % BURST_MESSAGES == 0:
            time.sleep(0.05)
    begin = time.monotonic()
    _work(harness, node)
    outcome.recovered(time.monotonic() - begin, harness.settings.patience_s, "the next valid message")
    grown, problems = harness.memory_mb(node) - memory_before, len(received.problems) - problems_before
    outcome.observed.append(f"{count} messages; continues with the next valid ones; {problems} problems reported")
    outcome.figures |= {"messages": count, "grown_mb": grown, "problems": problems}
    outcome.expect(process.is_running and process.popen.pid == pid, f"{node} has ended")
    outcome.expect(grown < GROWTH_MB, f"{node} has grown by {grown:.0f} MB")
    outcome.expect(problems > 0 or not reported, "no problem was reported on /diagnostics")
    outcome.expect("Traceback" not in process.text[text_before:], f"unexpected exception in {node}")


_CONTINUES = "runs on, continues"
_EXPECTED = "runs on, does not grow, reports it on /diagnostics, continues with the next valid pair"
_IMAGES = "images with wrong step, size, encoding, length; NaN; 4 GB claimed; broken PNG and JPEG"
_BYTES = "images and camera_info cut off, noise, lengths of 4 GB claimed (CDR)"
_INFOS = "camera_info of NaN, zero, 4294967295 pixels; poses of NaN, infinity, zero quaternions"
FAULTS = (
    Fault("pictures-localisation", f"to localisation: {_IMAGES}", _EXPECTED, partial(malformed_images, LOCALISATION)),
    Fault("bytes-localisation", f"to localisation: {_BYTES}", _CONTINUES, partial(malformed_bytes, LOCALISATION)),
    Fault("infos-localisation", f"to localisation: {_INFOS}", _EXPECTED, partial(malformed_camera_info, LOCALISATION)),
    Fault("pictures-mapping", f"to mapping: {_IMAGES}", _EXPECTED, partial(malformed_images, MAPPING)),
    Fault("bytes-mapping", f"to mapping: {_BYTES}", _CONTINUES, partial(malformed_bytes, MAPPING)),
    Fault("infos-mapping", f"to mapping: {_INFOS}", _EXPECTED, partial(malformed_camera_info, MAPPING)),
    Fault(
        "messages-monitor",
        "to the monitor: poses of NaN, calls without numbers, clouds of 4294967295 points, invalid JSON",
        "runs on, does not grow, reports it on /diagnostics, continues to score",
        malformed_score_inputs,
    ),
)
EMPTY = Fault(
    "empty-message",
    "a zero-length message on an image topic",
    "other publishers are not disturbed; its own works again when the message has left the history of the publisher",
    empty_message,
)
