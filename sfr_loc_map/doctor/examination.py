"""Checks of an observation: pure functions that return issues, each with its fix."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from sfr_loc_map.doctor.observation import EXPECTED, Observation, ObservedTopic, SourceKind, allowed_types
from sfr_loc_map.doctor.swapped_images import StampedImage, are_swapped
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.io.calibration.rectification import StereoRectifier, rig_of_infos
from sfr_loc_map.io.image_codec import SampleDepth, samples_of
from sfr_loc_map.issues import Cause, Issue
from sfr_loc_map.message_stamps import NS_PER_MS, NS_PER_S, stamp_of
from sfr_loc_map.message_text import counted
from sfr_loc_map.message_types import COMPRESSED, IMAGE
from sfr_loc_map.stamp_pairing import below_half_period, nearest_stamps
from sfr_loc_map.suite_names import SIDES
from sfr_loc_map.topics import NAV_POSE, RAW, RECTIFIED, TRUE_POINTS, TRUE_POSES
from sfr_loc_map.transport_issues import (
    COMPARABLE_NS,
    MUCH_LOST,
    Reliability,
    doubled_publishers,
    loss_fix,
    silence_of,
    wrong_type,
)

VIDEO = {
    "foxglove_msgs/msg/CompressedVideo",
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
    "theora_image_transport/msg/Packet",
}
"""Message types of video (H.264, H.265, Theora), which is not supported."""
FEW_LOST = 0.01  #: Fraction of images lost in transport above which there is a warning.
PAIRED = 0.5  #: Minimum fraction of stamps with a partner for a useful result.
COMPLETE = 0.9  #: Fraction of stamps with a partner below which there is a warning.
EDGE = 0.1  #: Fraction of the observed time at each end that is ignored, because partners may be outside.

Issues = Iterator[Issue]


def examine(seen: Observation) -> list[Issue]:
    """Return the issues of all checks, blocking issues first."""
    checks = [_source]
    if seen.topics or seen.broken is None:
        checks += [_names, _doubled, _waiting, _rigs, _extrinsics, _order, _poses, _truth, _nodes, _host_clock]
    issues = [issue for check in checks for issue in check(seen)]
    return sorted(issues, key=lambda issue: not issue.is_blocking)


def _rigs(seen: Observation) -> Issues:
    for rig in seen.rigs:
        yield from _camera_topics(seen, rig)
        if seen.has_images(rig):
            for check in (_transport, _pairs, _stereo):
                yield from check(seen, rig)


# ---- the source and its topics


def _source(seen: Observation) -> Issues:
    if seen.broken is not None:
        fix = seen.broken.advice or "correct, record or copy it again"
        yield Issue(Cause.BROKEN, seen.subject, _without_subject(seen.broken.problem, seen.subject), fix)
    if seen.skipped_pairs:
        pairs = counted(seen.skipped_pairs, "pair")
        text = f"{pairs} skipped because images, or poses of mapping pairs, are missing"
        fix = "restore the files or messages, or remove the pairs from the list"
        yield Issue(Cause.MISSING_IMAGES, seen.subject, text, fix, is_blocking=False)
    if seen.unfinished:
        text = "the bag was not closed: it has no end record"
        yield Issue(
            Cause.UNFINISHED, seen.subject, text, "rewrite it for other readers: sfr convert", is_blocking=False
        )


def _without_subject(text: str, subject: str) -> str:
    """Remove the name of the source from the beginning of a text, because the issue already states the name."""
    for name in (subject, f"bag {subject}"):
        if text.startswith(f"{name}: "):
            return text.removeprefix(f"{name}: ")
        if text.startswith(f"{name} "):
            return text.replace(name, "it", 1)
    return text


def _names(seen: Observation) -> Issues:
    for name, found in seen.ambiguous.items():
        fix = "choose one topic with --remap FOUND:=EXPECTED"
        yield Issue(Cause.AMBIGUOUS, name, f"several topics are possible: {', '.join(found)}", fix)
    if not seen.rigs and not seen.ambiguous:
        others, fix = _other_images(seen)
        text = f"neither loc/left/image_rect nor nav/left/image_rect exists (nor image_raw); {others}"
        yield Issue(Cause.NO_TOPIC, seen.subject, text, fix)


def _other_images(seen: Observation) -> tuple[str, str]:
    """Return which topics with other names have images or video, and the fix."""
    images = [name for name, types in sorted(seen.others.items()) if {IMAGE, COMPRESSED} & set(types)]
    if images:
        fix = "give --remap FOUND:=EXPECTED"
        return f"topics with images are {', '.join(images)}", f"start the cameras, or {fix}" if seen.is_live else fix
    videos = [f"{name} ({kind})" for name, types in sorted(seen.others.items()) for kind in set(types) & VIDEO]
    if videos:
        fix = "publish or record the images as sensor_msgs/Image, or as sensor_msgs/CompressedImage of JPEG or PNG"
        return f"topics with video, which is unsupported, are {', '.join(videos)}", fix
    if seen.is_live:
        fix = "start the cameras, or run this command with their ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE and "
        return "no topic has images", f"{fix}ROS_DISCOVERY_SERVER (the server must run)"
    return "no topic has images", "give a bag with images of both cameras"


def _doubled(seen: Observation) -> Issues:
    for topic in seen.topics.values():
        doubled = doubled_publishers(topic.source_name, topic.publishers or ())
        if doubled is not None:
            yield doubled


def _waiting(seen: Observation) -> Issues:
    for node in seen.waiting:
        text = "the node waits because no topic of its cameras has a publisher"
        fix = "start the cameras, or name their topics (sfr run --config); otherwise omit the node"
        yield Issue(Cause.NO_PUBLISHER, node.name, text, fix, is_blocking=False)


def _topic(seen: Observation, name: str, topic: ObservedTopic | None) -> Issues:
    if name in seen.ambiguous:
        return
    if topic is None or not topic.is_published:
        yield _missing(seen, name, topic)
        return
    heard = {p.node for other in seen.topics.values() if other.messages for p in other.publishers or ()}
    issue = _silence(name, topic, heard)
    is_silent = not topic.messages and not seen.is_idle(name.partition("/")[0])
    if is_silent or issue.cause in (Cause.WRONG_TYPE, Cause.QOS):
        yield issue


def _missing(seen: Observation, name: str, topic: ObservedTopic | None) -> Issue:
    """Return the issue of a topic that is not in the recording, or has no publisher on the graph."""
    where = topic.source_name if topic is not None else f"{seen.prefix}{name}"
    hint = "or name it with --remap FOUND:=EXPECTED"
    if where.endswith(RECTIFIED) and where.removesuffix(RECTIFIED) + RAW in seen.others:
        hint = f"or set input.rectify of the node: {RAW} exists"
    root = f"/{name}"
    if where != root and root in seen.others:
        hint = f"or start the node without its namespace: {root} exists"
    fix = f"publish or record it, {hint}"
    if seen.is_live:
        return replace(silence_of(where, allowed_types(name), ()), fix=fix)
    return Issue(Cause.NO_TOPIC, where, "the topic is not in the bag", fix)


def _silence(name: str, topic: ObservedTopic, heard: Collection[str] = ()) -> Issue:
    """Return why no message of a topic is received, by the doctor or by a node that requests more reliability."""
    if topic.publishers is None:
        return _silence_in_recording(topic, allowed_types(name))
    strict = Reliability.RELIABLE in topic.requests.values()
    requested = Reliability.RELIABLE if strict else Reliability.BEST_EFFORT
    wanted = allowed_types(name)
    return silence_of(topic.source_name, wanted, topic.publishers, requested, heard=heard)


def _silence_in_recording(topic: ObservedTopic, wanted: tuple[str, ...]) -> Issue:
    if not set(topic.types) & set(wanted):
        return wrong_type(topic.source_name, wanted, topic.types)
    return Issue(Cause.SILENT, topic.source_name, "the bag has no message on this topic", "record it again")


def _is_refused(name: str, topic: ObservedTopic) -> bool:
    """Return whether a node receives no message of a topic because the publishers offer less reliability."""
    return topic.is_published and _silence(name, topic).cause is Cause.QOS


def _camera_topics(seen: Observation, rig: str) -> Issues:
    for side in SIDES:
        images = seen.images(rig, side)
        yield from _topic(seen, f"{rig}/{side}/{seen.image_name(rig)}", images)
        name = f"{rig}/{side}/camera_info"
        yield from _topic(seen, name, seen.topics.get(name))
    node = seen.node(rig)
    if seen.is_idle(rig) and not (node is not None and node.has_worked):
        fix = "if pairs are expected, observe longer (--seconds) or record again"
        yield Issue(Cause.SILENT, seen.both_images(rig), "no pair was received", fix, is_blocking=False)


# ---- images of both sides


def _transport(seen: Observation, rig: str) -> Issues:
    share = seen.lost_share(rig)
    if share > FEW_LOST:
        text = f"{share:.0%} of the images are lost between their publisher and this process"
        fix = loss_fix(seen.export_line)
        yield Issue(Cause.TRANSPORT, seen.both_images(rig), text, fix, is_blocking=share > MUCH_LOST)


def _pairs(seen: Observation, rig: str) -> Issues:
    left, right = (seen.image_stamps(rig, side) for side in SIDES)
    if not len(left) or not len(right):  # images were received but are unusable
        return
    share, typical_ns = _paired(left, right, seen.tolerance_ns(rig))
    share = min(share / (1.0 - seen.lost_share(rig)), 1.0)  # images whose partner was lost in transport do not count
    text = f"{share:.0%} of the left images have a right image {_within(seen, rig)}"
    if PAIRED <= share < COMPLETE:
        fix = "check for lost images: transport, quality of service, load"
        yield Issue(Cause.UNPAIRED, seen.both_images(rig), text, fix, is_blocking=False)
    elif share < PAIRED:
        off_s = f"{typical_ns / NS_PER_S:.3g}"
        fix = "trigger both cameras together and give both images the stamp of the trigger"
        if typical_ns <= NS_PER_S // 2:
            section = "input" if seen.is_live else "sync"
            fix += f"; or set {section}.stamp_tolerance_s above {off_s}, if the motion in this time is negligible"
        yield Issue(
            Cause.UNSYNCHRONISED,
            seen.both_images(rig),
            f"only {text}: the nearest right image is typically {off_s} s away",
            fix,
        )


def _stereo(seen: Observation, rig: str) -> Issues:
    """Examine the calibration and the first images of a rig, which must be readable to detect swapped cameras."""
    rectifier: StereoRectifier | None = None
    size: tuple[int, int] | None = None
    infos = [topic for side in SIDES if (topic := seen.topics.get(f"{rig}/{side}/camera_info")) and topic.messages]
    if len(infos) == len(SIDES):
        is_raw = seen.image_name(rig) == RAW
        try:
            cameras, rectifier = rig_of_infos([topic.messages[0] for topic in infos], rig, raw=is_raw)
            size = cameras.width, cameras.height
        except InputError as error:
            where = f"{rig}/left/camera_info, {rig}/right/camera_info"
            yield Issue(Cause.CAMERA_INFO, where, error.problem, error.advice)
    images: list[list[StampedImage]] = []
    depth = SampleDepth(lambda _: None, rig)
    for side in SIDES:
        if (topic := seen.images(rig, side)) is None:
            return
        of_side = _images_of(topic, depth, size)
        if isinstance(of_side, Issue):
            yield of_side
            return
        images.append(of_side)
    left, right = images if rectifier is None else _rectified(rectifier, *images)
    if are_swapped(left, right):
        text = "objects are further right in the right images: left and right are swapped"
        where = f"{rig}/left/{seen.image_name(rig)}"
        yield Issue(Cause.SWAPPED, where, text, "swap the topics (cables, remaps)")


def _images_of(topic: ObservedTopic, depth: SampleDepth, size: tuple[int, int] | None) -> list[StampedImage] | Issue:
    """Return the images of a topic with their stamps; an issue if they are unreadable or differ from a known size.

    `size` is the width and height in camera_info.
    """
    try:
        read = depth.grey(*map(samples_of, topic.messages))
    except InputError as error:
        fix = "publish mono8, mono16, rgb8, bgr8, a Bayer mosaic or yuv422, or JPEG or PNG"
        return Issue(Cause.ENCODING, topic.source_name, str(error), fix)
    height, width = read[0].shape
    if size is not None and (width, height) != size:
        text = f"its images are {width} x {height}, but camera_info states {size[0]} x {size[1]}"
        return Issue(Cause.IMAGE_SIZE, topic.source_name, text, "publish the camera_info of these images")
    return [(stamp_of(message), image) for message, image in zip(topic.messages, read, strict=True)]


def _rectified(
    rectifier: StereoRectifier, lefts: list[StampedImage], rights: list[StampedImage]
) -> tuple[list[StampedImage], list[StampedImage]]:
    """Return the rectified images of both sides; surplus images of one side are ignored."""
    pairs = [
        [*zip((left_ns, right_ns), rectifier.rectify(left, right), strict=True)]
        for (left_ns, left), (right_ns, right) in zip(lefts, rights, strict=False)
    ]
    return [left for left, _ in pairs], [right for _, right in pairs]


# ---- stamps, truth, extrinsics, nodes


def _extrinsics(seen: Observation) -> Issues:
    node = seen.node("loc")
    given = seen.extrinsics_given or seen.extrinsics_in_tf or (node is not None and node.extrinsics_given)
    unknown = seen.broken is not None or (node is not None and not node.state)  # the node may have the extrinsics
    if "loc" not in seen.rigs or given or unknown:
        return
    transform = "the transform from rb to locsb"
    is_files = seen.kind is SourceKind.FILES
    place = "rig.json" if is_files else f"{transform} on /tf_static"
    text = f"neither a parameter nor {place} gives the extrinsics"
    if seen.extrinsics_in_tf is None:
        text = "no parameter gives the extrinsics, and /tf_static cannot be read without tf2_msgs"
    if seen.base_frame:
        text = f"/tf_static does not connect frames.base, '{seen.base_frame}', to the left camera"
    alternative = "give them in a rig.json" if is_files else f"publish {transform} on /tf_static"
    fix = f"set T_rb_locsb.translation_m and quat_xyzw of localisation_node (--config), or {alternative}"
    if not seen.is_live:
        other = "correct frames.base" if seen.base_frame else alternative
        fix = f"set extrinsics.translation_m and extrinsics.quat_xyzw in sfr.yaml (--set), or {other}"
    yield Issue(Cause.FRAMES, "extrinsics of the localisation rig (T_rb_locsb)", text, fix)


def _order(seen: Observation) -> Issues:
    # on a graph, decreasing stamps begin a new run
    topics = [(topic, 1) for rig in seen.rigs for side in SIDES if (topic := seen.images(rig, side)) is not None]
    if (truth := seen.topics.get(TRUE_POSES)) is not None:
        topics.append((truth, 0))
    for topic, least_ns in [] if seen.is_live else topics:
        if back := int(np.sum(np.diff(topic.stamps_ns) < least_ns)):
            text = f"its stamps go back or repeat at {back} messages, for example because a player restarted"
            fix = "record a single run: start the player after sfr record, without a loop"
            yield Issue(Cause.STAMP_ORDER, topic.source_name, text, fix)


def _poses(seen: Observation) -> Issues:
    if "nav" not in seen.rigs:
        return
    topic, images = seen.topics.get(NAV_POSE), seen.image_stamps("nav")
    if topic is None and seen.poses_from_head:
        if seen.head_problem is not None:
            text = _without_subject(seen.head_problem.problem, seen.subject)
            yield Issue(Cause.NO_TOPIC, NAV_POSE, text, seen.head_problem.advice)
        return
    yield from _topic(seen, NAV_POSE, topic)
    if topic is None or not len(topic.stamps_ns) or not len(images):
        return
    share, typical_ns = _paired(images, topic.stamps_ns, seen.tolerance_ns("nav"))
    if share < COMPLETE:
        within = _within(seen, "nav")
        text = (
            f"only {share:.0%} of the images have a pose {within}: the nearest pose is typically "
            f"{typical_ns / NS_PER_S:.3g} s away"
        )
        fix = "publish nav/pose with the stamp of each pair"
        yield Issue(Cause.POSE_STAMPS, topic.source_name, text, fix, is_blocking=share < PAIRED)


def _truth(seen: Observation) -> Issues:
    for rig, name in (("loc", TRUE_POSES), ("nav", TRUE_POINTS)):
        if rig in seen.rigs:
            yield from _truth_of_rig(seen, rig, name)


def _truth_of_rig(seen: Observation, rig: str, name: str) -> Issues:
    topic = seen.topics.get(name)
    if topic is not None and (set(topic.types) - set(EXPECTED[name]) or _is_refused(name, topic)):
        yield from _topic(seen, name, topic)
    elif topic is None or not topic.is_published or not len(topic.stamps_ns):
        # true points are published with the pairs, and are absent as long as there is no pair
        comes_with_pairs = rig == "nav" and topic is not None and topic.is_published
        if not (comes_with_pairs and (seen.is_live or seen.is_idle(rig))):
            fix = "record or publish it"
            if seen.kind is SourceKind.FILES:
                fix = "name its file by --set truth.source=FILE" if rig == "loc" else "add it to pairs.csv"
            yield Issue(Cause.TRUTH, name, "there is no truth: nothing can be scored", fix, is_blocking=False)
    else:
        yield from _truth_clock(topic, seen.image_stamps(rig))


def _truth_clock(topic: ObservedTopic, images_ns: IntArray) -> Issues:
    """Compare the time of a truth with that of the images, stamps `(N,)`."""
    if not len(images_ns):
        return
    if topic.stamps_ns.min() > images_ns.max() or images_ns.min() > topic.stamps_ns.max():
        off_s = (int(np.median(topic.stamps_ns)) - int(np.median(images_ns))) / NS_PER_S
        text = f"its stamps differ by {off_s:.6g} s from those of the images: nothing can be scored"
        fix = "stamp truth and images with one clock"
        yield Issue(Cause.TRUTH_CLOCK, topic.source_name, text, fix, is_blocking=False)


def _nodes(seen: Observation) -> Issues:
    for node in seen.nodes:
        if node.use_sim_time and not seen.has_clock:
            text = "use_sim_time is true but /clock has no publisher: the time of the node does not advance"
            fix = "set use_sim_time to false, or publish /clock (ros2 bag play --clock)"
            yield Issue(Cause.CLOCK, node.name, text, fix)
        if not node.state:
            text = "the node does not answer: its parameters are unknown"
            yield Issue(
                Cause.SILENT, node.name, text, "run sfr doctor again when the host is less busy", is_blocking=False
            )
        elif node.state != "active":
            transition = "activate" if node.state == "inactive" else "configure"
            fix = f"ros2 lifecycle set {node.name} {transition}"
            yield Issue(Cause.INACTIVE, node.name, f"the node is {node.state}", fix)


def _host_clock(seen: Observation) -> Issues:
    if seen.now_ns is None or seen.has_clock:
        return
    for rig in seen.rigs:
        stamps = seen.image_stamps(rig)
        off_ns = int(stamps[-1]) - seen.now_ns if len(stamps) else 0
        if abs(off_ns) > COMPARABLE_NS:
            off_s = f"{off_ns / NS_PER_S:.6g}"
            text = (
                f"stamps differ by {off_s} s from the time of this host: latencies are unknown, and tf may reject "
                "the stamps"
            )
            fix = "synchronise the clocks (chrony, PTP); play a bag with --clock and set use_sim_time"
            yield Issue(Cause.CLOCKS_APART, f"{rig}/left/{seen.image_name(rig)}", text, fix, is_blocking=False)


def _within(seen: Observation, rig: str) -> str:
    tolerance_ns = seen.tolerance_ns(rig)
    return f"within {tolerance_ns / NS_PER_MS:g} ms" if tolerance_ns else "with the same stamp"


def _paired(first: IntArray, second: IntArray, tolerance_ns: int) -> tuple[float, int]:
    """Return the fraction of the first stamps with a second stamp within the tolerance, and the median difference, ns.

    As in a `StampPairing`, the tolerance is less than half of the shorter period. The first stamps at both ends of the
    observed time are ignored, because their partners may be outside.
    """
    _, apart = nearest_stamps(first, np.sort(second))
    edge = EDGE * float(first.max() - first.min())
    inner = (first >= first.min() + edge) & (first <= first.max() - edge)
    if len(first) > 2 and inner.any():
        apart = apart[inner]
    gaps = [np.diff(stamps) for stamps in (first, second)]
    allowed_ns = below_half_period(tolerance_ns, *([*of_one[of_one > 0].tolist()] for of_one in gaps))
    return float(np.mean(apart <= allowed_ns)), int(np.median(apart))
