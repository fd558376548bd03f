"""What of an observation would stop the suite, by cause, with its cure. Pure functions of what was seen."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sfr_loc_map.constants import NS_PER_S, SIDES
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.io.bag import COMPRESSED, IMAGE
from sfr_loc_map.pipeline.doctor.observation import EXPECTED, TASKS, Finding, Observation, SeenTopic
from sfr_loc_map.pipeline.doctor.stereo import examine_stereo, nearest_ns

CLOCKS_APART_NS = 60 * NS_PER_S
"""Stamps further from the host's time are of another clock; the nodes leave their latencies out beyond it, too."""
PAIRED = 0.5
"""Share of stamps with a partner below which nothing sensible comes out."""
COMPLETE = 0.9
"""Share below which is warned."""
QUEUES_BYTES = 1_000_000
"""What a process has in /dev/shm beside its segment."""
EDGE = 0.1
"""Share of the time observed at either end in which a partner may not have been seen."""


def examine(seen: Observation) -> list[Finding]:
    """Return what is wrong, that which stops first."""
    found = [*_readable(seen)]
    if not (seen.broken and not seen.topics):
        tasks = _tasks(seen)
        found += _there(seen, tasks)
        for task in tasks:
            found += _topics(seen, task)
            if all((topic := seen.picture(task, side)) is not None and topic.messages for side in SIDES):
                found += _synchronised(seen, task)
                found += examine_stereo(seen, task)
        found += [*_frames(seen, tasks), *_poses(seen, tasks), *_truth(seen, tasks), *_clocks(seen, tasks)]
    found += _host(seen)
    return sorted(found, key=lambda finding: not finding.stops)


def _tasks(seen: Observation) -> list[str]:
    """Return the tasks that are meant: of nodes that run, else those of which something is there."""
    running = [task for task in TASKS if seen.node(task) is not None]
    return running or [task for task in TASKS if any(name.startswith(f"{task}/") for name in seen.topics)]


def _readable(seen: Observation) -> Iterator[Finding]:
    if seen.broken:
        yield Finding("broken", True, seen.subject, seen.broken, "record or copy it again; what is whole can be read")
    if seen.unfinished:
        yield Finding(
            "unfinished",
            False,
            seen.subject,
            "its recording was not finished: it has no end record",
            "nothing needs to be done here; for other readers write it anew: sfr convert",
        )


def _there(seen: Observation, tasks: list[str]) -> Iterator[Finding]:
    for name, found in seen.ambiguous.items():
        yield Finding(
            "ambiguous",
            True,
            name,
            f"several topics could be it: {', '.join(found)}",
            "choose a rover by --namespace, or one topic by --remap FOUND:=EXPECTED",
        )
    if not tasks and not seen.ambiguous:
        pictures = [n for n, types in sorted(seen.others.items()) if {IMAGE, COMPRESSED} & set(types)]
        there = f"topics with pictures are {', '.join(pictures)}" if pictures else "no topic has pictures"
        yield Finding(
            "no_topic",
            True,
            seen.subject,
            f"neither loc/left/image_rect nor nav/left/image_rect is there; {there}",
            "name them by --remap FOUND:=EXPECTED, or start the cameras" if seen.live else "--remap FOUND:=EXPECTED",
        )


def _topics(seen: Observation, task: str) -> Iterator[Finding]:
    for side in SIDES:
        name = f"{task}/{side}/image_rect"
        yield from _topic(seen, task, name, seen.picture(task, side))
        name = f"{task}/{side}/camera_info"
        yield from _topic(seen, task, name, seen.topics.get(name))


def _topic(seen: Observation, task: str, name: str, topic: SeenTopic | None) -> Iterator[Finding]:
    """Judge one topic without which the task does not work."""
    if name in seen.ambiguous:
        return
    if topic is None or not topic.offers:
        found = topic.found if topic is not None else f"{seen.prefix}{name}"
        cause = "no_publisher" if seen.live else "no_topic"
        text = "nobody publishes it" if seen.live else "it is not in the bag"
        cure = "start its publisher" if seen.live else "record it"
        yield Finding(cause, True, found, text, f"{cure}, or name it by --remap FOUND:=EXPECTED")
        return
    wanted = (*EXPECTED[name], COMPRESSED) if name.endswith("image_rect") else EXPECTED[name]
    wrong = [kind for kind in topic.types if kind not in wanted]
    if wrong:
        yield Finding(
            "wrong_type",
            True,
            topic.found,
            f"its type is {', '.join(wrong)}: {' or '.join(wanted)} is needed",
            "publish the right type, or name another topic by --remap FOUND:=EXPECTED",
        )
        return
    node = seen.node(task)
    asked = node.reliability if node is not None else "reliable"
    if seen.live and asked == "reliable" and "best_effort" in topic.offers:
        yield Finding(
            "qos",
            True,
            topic.found,
            "its publisher offers best_effort, reliable is asked for: nothing is received",
            "set input.reliability to best_effort, or the publisher's to reliable",
        )
    if not topic.messages:
        yield Finding(
            "silent",
            True,
            topic.found,
            "no message came" if seen.live else "it has no message",
            "look at its publisher" if seen.live else "record it again",
        )


def _synchronised(seen: Observation, task: str) -> Iterator[Finding]:
    left, right = (_stamps(seen.picture(task, side)) for side in SIDES)
    node = seen.node(task)
    tolerance = node.stamp_tolerance_ns if node is not None else 0
    share, typical_ns = _paired(left, right, tolerance)
    where = f"{task}/left/image_rect, {task}/right/image_rect"
    if share >= COMPLETE:
        return
    if share < PAIRED:
        cure = "let one trigger stamp both"
        if typical_ns <= NS_PER_S // 2:
            cure += (
                f"; or set input.stamp_tolerance_s above {typical_ns / NS_PER_S:.3g}, "
                "if so much motion may be neglected"
            )
        text = (
            f"{share:.0%} of the left pictures have a right one of their stamp, "
            f"typically {typical_ns / NS_PER_S:.3g} s off"
        )
        yield Finding("unsynchronised", True, where, text, cure)
    else:
        yield Finding(
            "unpaired",
            False,
            where,
            f"{share:.0%} of the left pictures have a right one of their stamp",
            "look for lost pictures: transport, quality of service, load",
        )


def _paired(first: IntArray, second: IntArray, tolerance_ns: int) -> tuple[float, int]:
    """Return the share of the first stamps that have a second one, and the typical distance to the next (ns)."""
    apart = nearest_ns(first, second)
    inside = _inner(first) if len(first) > 2 else np.ones(len(first), bool)
    return float(np.mean(apart[inside] <= tolerance_ns)), int(np.median(apart[inside]))


def _inner(stamps: IntArray) -> IntArray:
    edge = EDGE * float(stamps.max() - stamps.min())
    inner = (stamps >= stamps.min() + edge) & (stamps <= stamps.max() - edge)
    return inner if inner.any() else np.ones(len(stamps), bool)


def _stamps(topic: SeenTopic | None) -> IntArray:
    return topic.stamps_ns if topic is not None else np.zeros(0, np.int64)


def _frames(seen: Observation, tasks: list[str]) -> Iterator[Finding]:
    node = seen.node("loc")
    if "loc" not in tasks or seen.place_given or seen.place_in_frames or (node is not None and node.place_given):
        return
    if seen.place_in_frames is None:
        text = "/tf_static cannot be read without tf2_msgs, and no parameter says it"
    elif any(name.strip("/").endswith("tf_static") for name in seen.others):
        text = "/tf_static does not join rb and locsb, and no parameter says it"
    else:
        text = "neither a parameter nor /tf_static says it"
    cure = "set T_rb_locsb.translation_m and quat_xyzw of localisation_node"
    yield Finding(
        "frames",
        True,
        "place of the localisation cameras on the rover",
        text,
        cure if seen.live else f"{cure} (--config), or add rb to locsb to /tf_static",
    )


def _poses(seen: Observation, tasks: list[str]) -> Iterator[Finding]:
    if "nav" not in tasks:
        return
    topic = seen.topics.get("nav/pose")
    yield from _topic(seen, "", "nav/pose", topic)
    pictures = _stamps(seen.picture("nav", "left"))
    if topic is None or not len(topic.stamps_ns) or not len(pictures):
        return
    share, typical_ns = _paired(pictures, topic.stamps_ns, 0)
    if share < COMPLETE:
        yield Finding(
            "pose_stamps",
            share < PAIRED,
            topic.found,
            f"{share:.0%} of the pictures have a pose of their stamp, typically {typical_ns / NS_PER_S:.3g} s off",
            "publish nav/pose with the stamp of each pair",
        )


def _truth(seen: Observation, tasks: list[str]) -> Iterator[Finding]:
    for task, name in (("loc", "ground_truth/odometry"), ("nav", "ground_truth/points")):
        if task not in tasks:
            continue
        topic = seen.topics.get(name)
        pictures = _stamps(seen.picture(task, "left"))
        if topic is None or not topic.offers or not len(topic.stamps_ns):
            yield Finding("truth", False, name, "there is no truth: nothing can be scored", "record or publish it")
        elif set(topic.types) - set(EXPECTED[name]):
            yield from _topic(seen, "", name, topic)
        elif len(pictures) and not _overlap(topic.stamps_ns, pictures):
            off = (int(np.median(topic.stamps_ns)) - int(np.median(pictures))) / NS_PER_S
            yield Finding(
                "truth_clock",
                False,
                topic.found,
                f"its stamps lie {off:.6g} s from those of the pictures: nothing can be scored",
                "stamp truth and pictures by one clock",
            )


def _overlap(first: IntArray, second: IntArray) -> bool:
    return bool(first.min() <= second.max() and second.min() <= first.max())


def _clocks(seen: Observation, tasks: list[str]) -> Iterator[Finding]:
    for node in seen.nodes:
        if node.use_sim_time and not seen.has_clock:
            yield Finding(
                "clock",
                True,
                node.name,
                "use_sim_time is on but nobody publishes /clock: its time stands still",
                "set use_sim_time to false, or publish /clock (ros2 bag play --clock)",
            )
        if node.state not in ("active", ""):
            yield Finding(
                "inactive",
                True,
                node.name,
                f"the node is {node.state}",
                f"ros2 lifecycle set {node.name} {'activate' if node.state == 'inactive' else 'configure'}",
            )
    if seen.now_ns is None or seen.has_clock:
        return
    for task in tasks:
        stamps = _stamps(seen.picture(task, "left"))
        off_ns = int(stamps[-1]) - seen.now_ns if len(stamps) else 0
        if abs(off_ns) > CLOCKS_APART_NS:
            yield Finding(
                "clocks_apart",
                False,
                f"{task}/left/image_rect",
                f"stamps lie {off_ns / NS_PER_S:.6g} s from this host's time: "
                "no latencies are known, tf may refuse them",
                "set the clocks by one source (chrony, PTP); of a bag, play it with --clock and set use_sim_time",
            )


def _host(seen: Observation) -> Iterator[Finding]:
    processes = max(len(seen.nodes), 1) + 1  # and the publisher of the pictures
    needed = processes * (seen.segment_bytes + QUEUES_BYTES) if seen.segment_bytes else 0
    if seen.shared_memory_bytes is not None and seen.shared_memory_bytes < needed:
        yield Finding(
            "shared_memory",
            seen.live,
            "/dev/shm",
            f"it has {seen.shared_memory_bytes / 1e6:.0f} MB, {processes} processes reserve {needed / 1e6:.0f} MB: "
            f"pictures go by UDP and get lost",
            f"docker run --shm-size={-(-needed * 2 // 2**20)}m, or --ipc=host; mount -o remount,size=...",
        )
