"""The blocking issues of what was observed: checks by cause, findings with a fix. Pure functions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage, IntArray, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import NS_PER_S, SIDES
from sfr_loc_map.io.bag import COMPRESSED, IMAGE
from sfr_loc_map.io.bag_sequence import RAW, RECTIFIED
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import image_from_compressed_message, image_from_message, stamp_of
from sfr_loc_map.io.rectification import StereoRectifier, rectified_rig
from sfr_loc_map.pipeline.doctor_observation import EXPECTED, Observation, ObservedTopic, Reliability, allowed_types
from sfr_loc_map.pipeline.reception import MUCH_LOST, loss_fix


class Severity(StrEnum):
    """What a finding means for the suite."""

    BLOCKING = "blocking"
    """Something that is needed does not work."""
    WARNING = "warning"


class Cause(StrEnum):
    """Kinds of findings, for programs."""

    BROKEN = "broken"
    UNFINISHED = "unfinished"
    MISSING_IMAGES = "missing_images"
    AMBIGUOUS = "ambiguous"
    NO_TOPIC = "no_topic"
    NO_PUBLISHER = "no_publisher"
    WRONG_TYPE = "wrong_type"
    QOS = "qos"
    SILENT = "silent"
    TRANSPORT = "transport"
    CAMERA_INFO = "camera_info"
    ENCODING = "encoding"
    IMAGE_SIZE = "picture_size"
    SWAPPED = "exchanged"
    STAMP_ORDER = "stamp_order"
    UNSYNCHRONISED = "unsynchronised"
    UNPAIRED = "unpaired"
    POSE_STAMPS = "pose_stamps"
    TRUTH = "truth"
    TRUTH_CLOCK = "truth_clock"
    CLOCKS_APART = "clocks_apart"
    FRAMES = "frames"
    CLOCK = "clock"
    INACTIVE = "inactive"
    SHARED_MEMORY = "shared_memory"


@dataclass(frozen=True, slots=True)
class Finding:
    """One issue.

    Attributes:
        cause: Its kind.
        severity: Whether it blocks.
        where: Topic, node or file.
        text: What was found.
        fix: What to do.
    """

    cause: Cause
    severity: Severity
    where: str
    text: str
    fix: str

    @property
    def is_blocking(self) -> bool:
        """Tell whether something that is needed does not work."""
        return self.severity is Severity.BLOCKING

    def as_dict(self) -> dict[str, str | bool]:
        """Return it for JSON, under the public keys."""
        return {
            "cause": self.cause.value,
            "stops": self.is_blocking,
            "where": self.where,
            "text": self.text,
            "cure": self.fix,
        }


def blocking(cause: Cause, where: str, text: str, fix: str) -> Finding:
    """Return a finding that blocks."""
    return Finding(cause, Severity.BLOCKING, where, text, fix)


def warning(cause: Cause, where: str, text: str, fix: str) -> Finding:
    """Return a finding that does not block."""
    return Finding(cause, Severity.WARNING, where, text, fix)


FEW_LOST = 0.01
"""Share of images lost in transport above which there is a warning."""


def check_readable(seen: Observation) -> Iterator[Finding]:
    """Yield whether a bag or source is broken, was not closed or lacks files."""
    if seen.broken:
        fix = "correct or copy the file again" if seen.files else "record or copy it again; what is whole can be read"
        yield blocking(Cause.BROKEN, seen.subject, seen.broken, fix)
    if seen.left_out:
        yield warning(
            Cause.MISSING_IMAGES,
            seen.subject,
            f"{seen.left_out} pairs are listed whose images are not there: they are left out",
            "restore the files, or take the pairs out of the list",
        )
    if seen.unfinished:
        yield warning(
            Cause.UNFINISHED,
            seen.subject,
            "its recording was not finished: it has no end record",
            "nothing needs to be done here; for other readers rewrite it: sfr convert",
        )


def check_names(seen: Observation) -> Iterator[Finding]:
    """Yield names that several topics could have, and whether no topic has an expected name."""
    for name, found in seen.ambiguous.items():
        yield blocking(
            Cause.AMBIGUOUS,
            name,
            f"several topics could be it: {', '.join(found)}",
            "choose a rover by --namespace, or one topic by --remap FOUND:=EXPECTED",
        )
    if not seen.tasks and not seen.ambiguous:
        images = [n for n, types in sorted(seen.others.items()) if {IMAGE, COMPRESSED} & set(types)]
        there = f"topics with images are {', '.join(images)}" if images else "no topic has images"
        yield blocking(
            Cause.NO_TOPIC,
            seen.subject,
            f"neither loc/left/image_rect nor nav/left/image_rect is there (nor image_raw); {there}",
            "name them by --remap FOUND:=EXPECTED, or start the cameras" if seen.live else "--remap FOUND:=EXPECTED",
        )


def check_camera_topics(seen: Observation, task: str) -> Iterator[Finding]:
    """Yield issues of the topics of images and camera_info of a task."""
    for side in SIDES:
        yield from check_topic(seen, f"{task}/{side}/{seen.image_name(task)}", seen.images(task, side))
        name = f"{task}/{side}/camera_info"
        yield from check_topic(seen, name, seen.topics.get(name))
    node = seen.node(task)
    if seen.is_idle(task) and not (node is not None and node.has_worked):
        end = "watch until a pair comes (--seconds)" if seen.live else "record it again, if there should be pairs"
        yield warning(Cause.SILENT, seen.both_images(task), "no pair came meanwhile", end)


def check_transport(seen: Observation, task: str) -> Iterator[Finding]:
    """Yield whether images of a task are lost on the way from their publishers."""
    share = seen.lost_share(task)
    if share > FEW_LOST:
        yield Finding(
            Cause.TRANSPORT,
            Severity.BLOCKING if share > MUCH_LOST else Severity.WARNING,
            seen.both_images(task),
            f"{share:.0%} of the images are lost between their publisher and this process",
            loss_fix(seen.memory.export_line),
        )


def check_topic(seen: Observation, name: str, topic: ObservedTopic | None) -> Iterator[Finding]:
    """Yield issues of one topic that a task needs.

    Args:
        seen: What was observed.
        name: The suite's name of the topic.
        topic: The topic, None where it is absent.
    """
    if name in seen.ambiguous:
        return
    if topic is None or not topic.offers:
        yield _absent(seen, topic.found if topic is not None else f"{seen.prefix}{name}")
    elif set(topic.types) - set(allowed_types(name)):
        yield _wrong_type(name, topic)
    else:
        strict = [node for node, requested in topic.requests.items() if requested is Reliability.RELIABLE]
        if strict and Reliability.BEST_EFFORT in topic.offers:
            yield blocking(
                Cause.QOS,
                topic.found,
                f"its publisher offers best_effort, {', '.join(strict)} requests reliable: nothing is received",
                f"set qos_overrides.{topic.found}.subscription.reliability of the node to best_effort (or "
                f"input.reliability), or the publisher's to reliable",
            )
        if not topic.messages and not seen.is_idle(name.partition("/")[0]):
            yield _silent(seen, topic)


def _absent(seen: Observation, name: str) -> Finding:
    hint = "or name it by --remap FOUND:=EXPECTED"
    if name.endswith(RECTIFIED) and name.removesuffix(RECTIFIED) + RAW in seen.others:
        hint = f"or set input.rectify of the node: {RAW} is there"
    if seen.live:
        return blocking(Cause.NO_PUBLISHER, name, "it has no publisher", f"start its publisher, {hint}")
    return blocking(Cause.NO_TOPIC, name, "it is not in the bag", f"record it, {hint}")


def _wrong_type(name: str, topic: ObservedTopic) -> Finding:
    allowed = allowed_types(name)
    wrong = [kind for kind in topic.types if kind not in allowed]
    return blocking(
        Cause.WRONG_TYPE,
        topic.found,
        f"its type is {', '.join(wrong)}: {' or '.join(allowed)} is needed",
        "publish the right type, or name another topic by --remap FOUND:=EXPECTED",
    )


def _silent(seen: Observation, topic: ObservedTopic) -> Finding:
    if seen.live:
        return blocking(Cause.SILENT, topic.found, "no message was received", "check its publisher")
    return blocking(Cause.SILENT, topic.found, "it has no message", "record it again")


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


CORNERS = 80
PATCH_PX = 6
"""Half the side of a patch that is searched for."""
MIN_NCC = 0.85
"""Normalised cross-correlation of a patch that is matched."""
MIN_MATCHES = 10
"""Matches on the wrong side that a decision needs."""
SWAPPED_RATIO = 4.0
"""Swapped: more than so many matches on the wrong side for each on the right one."""
StampedImages = list[tuple[int, GreyImage]]


def check_stereo(seen: Observation, task: str) -> Iterator[Finding]:
    """Yield issues of camera_info and images of a rig whose images are there."""
    rig: StereoRig | None = None
    rectifier: StereoRectifier | None = None
    try:
        rig, rectifier = _rig(seen, task)
    except InputError as error:
        text, _, fix = str(error).partition(": ")
        yield blocking(Cause.CAMERA_INFO, f"{task}/left/camera_info, {task}/right/camera_info", text, fix)
    images: dict[str, StampedImages] = {}
    for side in SIDES:
        topic = seen.images(task, side)
        if topic is None:
            return
        try:
            images[side] = [(stamp_of(message), _grey(message)) for message in topic.messages]
        except InputError as error:
            yield _encoding(topic, error)
            return
        height, width = images[side][0][1].shape
        if rig is not None and (width, height) != (rig.width, rig.height):
            text = f"its images are {width} x {height}, camera_info says {rig.width} x {rig.height}"
            yield blocking(Cause.IMAGE_SIZE, topic.found, text, "publish the camera_info of these images")
            return
    if rectifier is not None:
        images = _rectified(images, rectifier)
    if left_right_swapped(images["left"], images["right"]):
        text = "objects lie further right in the right images: left and right are swapped"
        yield blocking(Cause.SWAPPED, f"{task}/left/{seen.image_name(task)}", text, "swap the topics (cables, remaps)")


def left_right_swapped(lefts: StampedImages, rights: StampedImages) -> bool:
    """Tell by patches of the left images whether they lie further right in the right ones of the nearest stamp.

    A point in front of parallel cameras lies at u_left - u_right = f baseline / Z > 0.
    """
    if lefts[0][1].shape != rights[0][1].shape:
        return False
    shifts = np.zeros(0)
    for stamp_ns, left in lefts:
        _, right = min(rights, key=lambda item: abs(item[0] - stamp_ns))
        shifts = np.concatenate((shifts, _shifts(left, right)))
    wrong, correct = int(np.sum(shifts < -0.5)), int(np.sum(shifts > 0.5))
    return wrong >= MIN_MATCHES and wrong > SWAPPED_RATIO * correct


def _rig(seen: Observation, task: str) -> tuple[StereoRig | None, StereoRectifier | None]:
    """Return the rig of the first camera_info of both sides, None where one is absent, and what rectifies raw images.

    Raises:
        InputError: If they are not those of a rectified rig, or of raw cameras that can be rectified.
    """
    infos = [topic for side in SIDES if (topic := seen.topics.get(f"{task}/{side}/camera_info")) and topic.messages]
    if len(infos) < len(SIDES):
        return None, None
    messages = [topic.messages[0] for topic in infos]
    if seen.image_name(task) == RAW:
        return rectified_rig(messages, task)
    return rig_from_camera_info(messages[0], messages[1], task), None


def _rectified(images: Mapping[str, StampedImages], rectifier: StereoRectifier) -> dict[str, StampedImages]:
    """Return rectified images; sides with more images than the other are cut."""
    pairs = list(zip(*(images[side] for side in SIDES), strict=False))
    rectified = [rectifier.rectify(left, right) for (_, left), (_, right) in pairs]
    return {
        side: [(pair[at][0], both[at]) for pair, both in zip(pairs, rectified, strict=True)]
        for at, side in enumerate(SIDES)
    }


def _encoding(topic: ObservedTopic, error: InputError) -> Finding:
    return blocking(
        Cause.ENCODING, topic.found, str(error), "publish mono8, mono16, rgb8, bgr8, a Bayer mosaic or yuv422"
    )


def _grey(message: Any) -> GreyImage:  # noqa: ANN401 - Image or CompressedImage of any library
    return image_from_message(message) if hasattr(message, "encoding") else image_from_compressed_message(message)


def _shifts(left: GreyImage, right: GreyImage) -> FloatArray:
    """Return u_left - u_right of distinct patches of the left image that are matched in their row of the right one."""
    corners = cv2.goodFeaturesToTrack(left, CORNERS, 0.02, 2.0 * PATCH_PX)
    found = []
    for u, v in np.rint(np.empty((0, 2)) if corners is None else corners[:, 0]).astype(int):
        patch = left[max(v - PATCH_PX, 0) : v + PATCH_PX + 1, max(u - PATCH_PX, 0) : u + PATCH_PX + 1]
        rows = right[max(v - PATCH_PX, 0) : v + PATCH_PX + 1]
        scores = cv2.matchTemplate(rows, patch, cv2.TM_CCOEFF_NORMED)[0]
        best = int(np.argmax(scores))
        if scores[best] > MIN_NCC:
            found.append(float(max(u - PATCH_PX, 0) - best))
    return np.array(found)


QUEUES_BYTES = 1_000_000
"""What a process has in /dev/shm beside its segment."""


def check_extrinsics(seen: Observation) -> Iterator[Finding]:
    """Yield whether the extrinsics of the localisation rig are unknown."""
    node = seen.node("loc")
    given = seen.extrinsics_given or seen.extrinsics_in_tf or (node is not None and node.extrinsics_given)
    if "loc" not in seen.tasks or given:
        return
    if seen.files:
        text = "rig.json does not have it, and no parameter"
    elif seen.extrinsics_in_tf is None:
        text = "/tf_static cannot be read without tf2_msgs, and no parameter has it"
    elif any(name.strip("/").endswith("tf_static") for name in seen.others):
        text = "/tf_static does not connect rb and locsb, and no parameter has it"
    else:
        text = "neither a parameter nor /tf_static has it"
    place = "it to rig.json" if seen.files else "rb to locsb to /tf_static"
    fix = "set T_rb_locsb.translation_m and quat_xyzw of localisation_node"
    yield blocking(
        Cause.FRAMES,
        "extrinsics of the localisation rig (T_rb_locsb)",
        text,
        fix if seen.live else f"{fix} (--config), or add {place}",
    )


def check_nodes(seen: Observation) -> Iterator[Finding]:
    """Yield nodes without a clock, and nodes that are not active."""
    for node in seen.nodes:
        if node.use_sim_time and not seen.has_clock:
            yield blocking(
                Cause.CLOCK,
                node.name,
                "use_sim_time is on but /clock has no publisher: its time stops",
                "set use_sim_time to false, or publish /clock (ros2 bag play --clock)",
            )
        if node.state not in ("active", ""):
            transition = "activate" if node.state == "inactive" else "configure"
            yield blocking(
                Cause.INACTIVE, node.name, f"the node is {node.state}", f"ros2 lifecycle set {node.name} {transition}"
            )


def check_shared_memory(seen: Observation) -> Iterator[Finding]:
    """Yield whether /dev/shm is too small."""
    processes = max(len(seen.nodes), 1) + 1  # and the image publisher
    memory = seen.memory
    needed = processes * (memory.segment_bytes + QUEUES_BYTES) if memory.segment_bytes else 0
    if memory.size_bytes is not None and memory.size_bytes < needed:
        yield Finding(
            Cause.SHARED_MEMORY,
            Severity.BLOCKING if seen.live else Severity.WARNING,
            "/dev/shm",
            f"it has {memory.size_bytes / 1e6:.0f} MB, {processes} processes reserve {needed / 1e6:.0f} MB: "
            f"images go by UDP and are dropped",
            f"docker run --shm-size={-(-needed * 2 // 2**20)}m, or --ipc=host; mount -o remount,size=...",
        )


IMAGE_CHECKS: tuple[Callable[[Observation, str], Iterator[Finding]], ...] = (check_transport, check_pairs, check_stereo)
"""Checks of a task with images of both sides."""
CHECKS: tuple[Callable[[Observation], Iterator[Finding]], ...] = (
    check_extrinsics,
    check_order,
    check_poses,
    check_truth,
    check_nodes,
    check_host_clock,
)


def examine(seen: Observation) -> list[Finding]:
    """Return the findings of all checks, blocking ones first."""
    found = [*check_readable(seen)]
    if not (seen.broken and not seen.topics):
        found += check_names(seen)
        for task in seen.tasks:
            found += check_camera_topics(seen, task)
            if seen.has_images(task):
                found += [finding for check in IMAGE_CHECKS for finding in check(seen, task)]
        found += [finding for check in CHECKS for finding in check(seen)]
    found += check_shared_memory(seen)
    return sorted(found, key=lambda finding: not finding.is_blocking)
