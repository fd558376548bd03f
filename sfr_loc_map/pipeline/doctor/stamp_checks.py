"""Checks of stamps: of stereo pairs, poses, truth, and against the clock of the host."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sfr_loc_map.geometry.arrays import IntArray, Mask
from sfr_loc_map.inputs import NS_PER_S, SIDES
from sfr_loc_map.pipeline.doctor.finding import Cause, Finding, Severity, blocking, warning
from sfr_loc_map.pipeline.doctor.observation import EXPECTED, Observation, ObservedTopic
from sfr_loc_map.pipeline.doctor.topic_checks import check_topic

CLOCKS_APART_NS = 60 * NS_PER_S
"""Stamps further from the time of the host are of another clock; the nodes omit their latencies, too."""
PAIRED = 0.5
"""Share of stamps with a partner below which no useful result is possible."""
COMPLETE = 0.9
"""Share of stamps with a partner below which there is a warning."""
EDGE = 0.1
"""Share of the observed time at either end in which a partner may lie outside."""


def check_pairs(seen: Observation, task: str) -> Iterator[Finding]:
    """Yield whether left and right images have no common stamps."""
    node = seen.node(task)
    tolerance_ns = node.stamp_tolerance_ns if node is not None else 0
    share, typical_ns = _paired(seen.image_stamps(task, "left"), seen.image_stamps(task, "right"), tolerance_ns)
    share = min(share / (1.0 - seen.lost_share(task)), 1.0)  # of those whose partner was not lost in transport
    if share >= COMPLETE:
        return
    where = seen.both_images(task)
    text = f"{share:.0%} of the left images have a right one of their stamp"
    if share >= PAIRED:
        fix = "check for lost images: transport, quality of service, load"
        yield warning(Cause.UNPAIRED, where, text, fix)
        return
    off_s = f"{typical_ns / NS_PER_S:.3g}"
    fix = "let one trigger stamp both"
    if typical_ns <= NS_PER_S // 2:
        fix += f"; or set input.stamp_tolerance_s above {off_s}, if so much motion may be neglected"
    yield blocking(Cause.UNSYNCHRONISED, where, f"{text}, typically {off_s} s off", fix)


def check_order(seen: Observation) -> Iterator[Finding]:
    """Yield topics of a bag whose stamps go back; on a graph that is a new run."""
    ordered = [topic for task in seen.tasks for side in SIDES if (topic := seen.images(task, side)) is not None]
    truth = seen.topics.get("ground_truth/odometry")
    for topic in [] if seen.live else [*ordered, *([truth] if truth is not None else [])]:
        back = int(np.sum(np.diff(topic.stamps_ns) < (0 if topic is truth else 1)))
        if back:
            yield blocking(
                Cause.STAMP_ORDER,
                topic.found,
                f"its stamps go back or stand still at {back} messages, as where a player began again meanwhile",
                "record one run alone: start the player after sfr record, without a loop",
            )


def check_poses(seen: Observation) -> Iterator[Finding]:
    """Yield issues of the poses of the mapping pairs."""
    if "nav" not in seen.tasks:
        return
    topic = seen.topics.get("nav/pose")
    yield from check_topic(seen, "nav/pose", topic)
    images = seen.image_stamps("nav")
    if topic is None or not len(topic.stamps_ns) or not len(images):
        return
    share, typical_ns = _paired(images, topic.stamps_ns, 0)
    if share < COMPLETE:
        yield Finding(
            Cause.POSE_STAMPS,
            Severity.BLOCKING if share < PAIRED else Severity.WARNING,
            topic.found,
            f"{share:.0%} of the images have a pose of their stamp, typically {typical_ns / NS_PER_S:.3g} s off",
            "publish nav/pose with the stamp of each pair",
        )


def check_truth(seen: Observation) -> Iterator[Finding]:
    """Yield whether there is no truth, or of another clock."""
    for task, name in (("loc", "ground_truth/odometry"), ("nav", "ground_truth/points")):
        if task not in seen.tasks:
            continue
        topic, images = seen.topics.get(name), seen.image_stamps(task)
        if topic is not None and set(topic.types) - set(EXPECTED[name]):
            yield from check_topic(seen, name, topic)
        elif topic is None or not topic.offers or not len(topic.stamps_ns):
            if _comes_later(seen, task, topic):
                continue
            yield warning(
                Cause.TRUTH,
                name,
                "there is no truth: nothing can be scored",
                "add it" if seen.files else "record or publish it",
            )
        elif len(images) and not _overlap(topic.stamps_ns, images):
            off_s = (int(np.median(topic.stamps_ns)) - int(np.median(images))) / NS_PER_S
            yield warning(
                Cause.TRUTH_CLOCK,
                topic.found,
                f"its stamps lie {off_s:.6g} s from those of the images: nothing can be scored",
                "stamp truth and images by one clock",
            )


def _comes_later(seen: Observation, task: str, topic: ObservedTopic | None) -> bool:
    """Tell whether a truth without messages comes with pairs that come now and then."""
    return task == "nav" and topic is not None and bool(topic.offers) and (seen.live or seen.is_idle(task))


def check_host_clock(seen: Observation) -> Iterator[Finding]:
    """Yield whether stamps are of another clock than that of the host."""
    if seen.now_ns is None or seen.has_clock:
        return
    for task in seen.tasks:
        stamps = seen.image_stamps(task)
        off_ns = int(stamps[-1]) - seen.now_ns if len(stamps) else 0
        if abs(off_ns) > CLOCKS_APART_NS:
            yield warning(
                Cause.CLOCKS_APART,
                f"{task}/left/{seen.image_name(task)}",
                f"stamps lie {off_ns / NS_PER_S:.6g} s from the time of this host: "
                "latencies are unknown, tf may refuse them",
                "set the clocks by one source (chrony, PTP); of a bag, play it with --clock and set use_sim_time",
            )


def nearest_ns(first: IntArray, second: IntArray) -> IntArray:
    """Return how far the nearest of the second stamps is from each of the first `(N,)`, nanoseconds."""
    second = np.sort(second)
    at = np.searchsorted(second, first)
    below, above = second[np.maximum(at - 1, 0)], second[np.minimum(at, len(second) - 1)]
    return np.asarray(np.minimum(np.abs(first - below), np.abs(above - first)), np.int64)


def _paired(first: IntArray, second: IntArray, tolerance_ns: int) -> tuple[float, int]:
    """Return the share of the first stamps that have a second one, and the typical distance to the nearest (ns)."""
    apart = nearest_ns(first, second)
    inside = _inner(first) if len(first) > 2 else np.ones(len(first), np.bool_)
    return float(np.mean(apart[inside] <= tolerance_ns)), int(np.median(apart[inside]))


def _inner(stamps: IntArray) -> Mask:
    edge = EDGE * float(stamps.max() - stamps.min())
    inner: Mask = (stamps >= stamps.min() + edge) & (stamps <= stamps.max() - edge)
    return inner if inner.any() else np.ones(len(stamps), np.bool_)


def _overlap(first: IntArray, second: IntArray) -> bool:
    return bool(first.min() <= second.max() and second.min() <= first.max())
