"""Broken and hostile messages: no node may die, hang, grow or stop working of one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial

from sensor_msgs.msg import Image

from sfr_loc_map.fault_injection import malformed_messages as hostile
from sfr_loc_map.fault_injection.harness import LOCALISATION, MAPPING, MATCH_S, MONITOR, SENT_DEPTH, Bench
from sfr_loc_map.fault_injection.malformed_messages import MalformedMessage
from sfr_loc_map.fault_injection.outcome import Fault, Outcome
from sfr_loc_map.geometry.stereo import StereoPair

GROWTH_MB = 100.0
"""A message may not make a node grow by more than this."""
MESSAGES_AT_ONCE = 10
RATE_HZ = 10.0


def malformed_images(node: str, bench: Bench, outcome: Outcome) -> None:
    """Send pictures with wrong steps, sizes, encodings and data."""
    name, work = _part(node, bench)
    picture = _pair(name, bench).left
    messages = (message for both in hostile.pictures(name, picture, bench.next_stamp) for message in both)
    _strike(bench, outcome, node, messages, work, told=True)


def hostile_bytes(node: str, bench: Bench, outcome: Outcome) -> None:
    """Send pictures and camera_info that cannot be deserialised."""
    name, work = _part(node, bench)
    rig = bench.scene.loc if name == "loc" else bench.scene.nav
    _strike(bench, outcome, node, hostile.broken_bytes(name, _pair(name, bench), rig), work, told=False)


def hostile_infos(node: str, bench: Bench, outcome: Outcome) -> None:
    """Send camera_info that no camera has, and poses that are none."""
    name, work = _part(node, bench)
    rig = bench.scene.loc if name == "loc" else bench.scene.nav
    infos = [info for pair in hostile.camera_infos(name, bench.next_stamp(), rig) for info in pair]
    poses = hostile.poses_for_localisation if name == "loc" else hostile.poses_for_mapping
    _strike(bench, outcome, node, [*infos, *poses(bench.next_stamp())], work, told=True)


def hostile_scores(bench: Bench, outcome: Outcome) -> None:
    """Send the monitor poses, calls, clouds and configurations that are none."""

    def work() -> None:
        known = bench.monitored
        bench.localise()
        bench.until(lambda: bench.monitored > known, "score of the pose")

    _strike(bench, outcome, MONITOR, hostile.messages_for_monitor(bench.next_stamp()), work, told=True)


def empty_message(bench: Bench, outcome: Outcome) -> None:
    """Send a message of no bytes at all, by a stranger and by the camera itself.

    Fast DDS 2 does not deliver it, and a reliable reader then waits for it before it hands out what the same writer
    sent later, until it has left the writer's history. Other writers are not held up.
    """
    topic = "loc/left/image_rect"
    bench.publisher(Image, topic)
    stranger = bench.node.create_publisher(Image, topic, SENT_DEPTH)
    bench.until(lambda: stranger.get_subscription_count() > 0, f"a listener on {topic}")
    time.sleep(MATCH_S)
    stranger.publish(b"")
    bench.localise(3)
    outcome.observed.append("sent by a stranger it does not disturb the camera's pictures")
    bench.node.destroy_publisher(stranger)
    first = bench.next_stamp()
    bench.publisher(Image, topic).publish(b"")
    begin, count = time.monotonic(), len(bench.odometry)
    with bench.driving(RATE_HZ):
        bench.until(lambda: len(bench.odometry) > count, "odometry")
        outcome.recover_s = time.monotonic() - begin
        time.sleep(1.0)
    bench.settle()
    sent = [stamp for stamp in bench.sent if stamp > first]
    missing = sum(stamp not in bench.odometry for stamp in sent)
    outcome.observed.append(
        f"sent by the camera's own publisher it holds up what that sends, until {SENT_DEPTH} more have pushed it out"
    )
    outcome.lost = f"{missing} of {len(sent)} pairs" if missing else "nothing"


def _part(node: str, bench: Bench) -> tuple[str, Callable[[], object]]:
    """Return the first part of a node's topics, and what it must still be able to do."""
    return ("loc", lambda: bench.localise(2)) if node == LOCALISATION else ("nav", bench.map)


def _pair(name: str, bench: Bench) -> StereoPair:
    stamp_ns = bench.next_stamp()
    return bench.scene.loc_pair(0, stamp_ns) if name == "loc" else bench.scene.nav_pair(0, stamp_ns)


def _strike(
    bench: Bench,
    outcome: Outcome,
    node: str,
    messages: Iterable[MalformedMessage],
    work: Callable[[], object],
    *,
    told: bool,
) -> None:
    """Publish messages; then the node must live, work, be no larger and have told of the messages."""
    process = bench.nodes[node]
    pid, before, said, text = process.popen.pid, bench.memory_mb(node), len(bench.problems), len(process.text)
    count = 0
    for item in messages:
        bench.publish(item.kind, item.topic, item.message)
        count += 1
        if count % MESSAGES_AT_ONCE == 0:
            time.sleep(0.05)
    begin = time.monotonic()
    work()
    outcome.recovered(time.monotonic() - begin, bench.settings.patience_s, "the next honest message")
    grown, problems = bench.memory_mb(node) - before, len(bench.problems) - said
    outcome.observed.append(f"{count} messages; works on with the next honest ones; {problems} problems told")
    outcome.figures |= {"messages": count, "grown_mb": grown, "problems": problems}
    outcome.expect(process.lives and process.popen.pid == pid, f"{node} has ended")
    outcome.expect(grown < GROWTH_MB, f"{node} has grown by {grown:.0f} MB")
    outcome.expect(problems > 0 or not told, "no problem was told on /diagnostics")
    outcome.expect("Traceback" not in process.text[text:], f"{node} met an exception that was not foreseen")


_EXPECTED = "lives, does not grow, tells of it on /diagnostics, works on with the next honest pair"
_PICTURES = "pictures with wrong step, size, encoding, length; NaN; 4 GB claimed; broken PNG and JPEG"
_BYTES = "pictures and camera_info cut off, noise, lengths of 4 GB claimed (CDR)"
_INFOS = "camera_info of NaN, zero, 4294967295 pixels; poses of NaN, infinity, zero quaternions"
FAULTS = (
    Fault("pictures-localisation", f"to localisation: {_PICTURES}", _EXPECTED, partial(malformed_images, LOCALISATION)),
    Fault("bytes-localisation", f"to localisation: {_BYTES}", "lives, works on", partial(hostile_bytes, LOCALISATION)),
    Fault("infos-localisation", f"to localisation: {_INFOS}", _EXPECTED, partial(hostile_infos, LOCALISATION)),
    Fault("pictures-mapping", f"to mapping: {_PICTURES}", _EXPECTED, partial(malformed_images, MAPPING)),
    Fault("bytes-mapping", f"to mapping: {_BYTES}", "lives, works on", partial(hostile_bytes, MAPPING)),
    Fault("infos-mapping", f"to mapping: {_INFOS}", _EXPECTED, partial(hostile_infos, MAPPING)),
    Fault(
        "messages-monitor",
        "to the monitor: poses of NaN, calls without numbers, clouds of 4294967295 points, JSON that is none",
        "lives, does not grow, tells of it on /diagnostics, scores on",
        hostile_scores,
    ),
)
EMPTY = Fault(
    "empty-message",
    "a message of no bytes at all on a topic of pictures",
    "other publishers are not disturbed; its own works again when the message has left the publisher's history",
    empty_message,
)
