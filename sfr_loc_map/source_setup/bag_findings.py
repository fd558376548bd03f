"""What the messages of a bag add to a proposal: topics, origin and offset of stamps, and the baseline."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.configuration.sections import Key
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.poses import read_frame_tree
from sfr_loc_map.io.layouts.bag_cameras import image_name
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, IMAGE
from sfr_loc_map.source_setup.proposal import Proposal, Value
from sfr_loc_map.source_setup.seen_topics import seen_topics
from sfr_loc_map.source_setup.topic_guess import guess_topics
from sfr_loc_map.stamp_pairing import MAX_TOLERANCE_S, below_half_period, nearest_stamps
from sfr_loc_map.suite_names import SIDES, Task
from sfr_loc_map.topics import COMPRESSED_END, TRUE_POSES

FEWEST_STAMPS = 3  #: Minimum number of left, and of right, stamps from which an offset is inferred.
STEADY = 0.1  #: Largest variation of a constant offset of the right stamps, as a fraction of the period.


def with_topics(proposal: Proposal, bag: Bag) -> Proposal:
    """Add the topics of images, calibration and truth that the bag has under other names."""
    given = proposal.config
    guess = guess_topics(seen_topics(bag))
    values: list[Value] = []
    for plain, topic in guess.topics.items():
        name = f"{plain}{COMPRESSED_END}" if bag.topics[topic] == COMPRESSED else plain
        if not bag.matches(name) and topic not in given.topics.values():
            values.append(Value(Key("topics", name), topic, guess.reasons[plain]))
    if guess.layout:
        values.append(
            Value(Key("calibration", "stereo_layout"), guess.layout, "by the width and height of its images; likely")
        )
    if guess.truth and not bag.matches(TRUE_POSES) and not given.truth.source and not given.truth.frame:
        values.append(Value(Key("truth", "source"), guess.truth, guess.truth_reason))
    return proposal.adding(*values, remarks=guess.remarks)


def with_origin_of_stamps(proposal: Proposal, bag: Bag) -> Proposal:
    """Add the times of recording as stamps if the header stamps of all images are 0."""
    topics = [topic for task in Task for topic in _image_topics(bag, task.rig)]
    count = 0
    for _, stamp_ns, _ in bag.stream(topics):
        if stamp_ns:
            return proposal
        count += 1
    if count < 2:
        return proposal
    return proposal.adding(Value(Key("sync", "stamps"), "record", "all stamps of the headers are 0; sure"))


def with_calibration(proposal: Proposal, bag: Bag) -> Proposal:
    """Add the baseline from /tf_static if camera_info has none, or report that the calibration is missing.

    Two frames at one position have no baseline.
    """
    given = proposal.config.calibration
    infos = [bag.find(f"loc/{side}/camera_info", CAMERA_INFO) for side in SIDES]
    messages = bag.first([topic for topic in infos if topic is not None])
    if image_name(bag, "loc") is None or given.file:
        return proposal
    if len(messages) < len(SIDES):
        text = "no camera_info: give --calibration FILE (Kalibr, OpenCV, ROS, COLMAP, EuRoC, ORB-SLAM or rig.json)"
        return proposal.adding(missing=[text])
    left, right = (messages[f"loc/{side}/camera_info"] for side in SIDES)
    if right.p[3] != 0 or left.p[3] != 0 or given.baseline_m:
        return proposal
    joined = read_frame_tree(bag).find(left.header.frame_id.strip("/"), right.header.frame_id.strip("/"))
    if joined is None or not joined.translation.any():
        return proposal.adding(missing=["P[3] of the right camera_info is 0: give --set calibration.baseline_m=METRES"])
    baseline = float(round(np.linalg.norm(joined.translation), 9))
    reason = "P[3] is 0; from /tf_static, left to right frame; sure"
    return proposal.adding(Value(Key("calibration", "baseline_m"), baseline, reason))


def _image_topics(bag: Bag, rig: str) -> list[Topic]:
    """Return the topics of the images of a rig, left first; empty without images."""
    image = image_name(bag, rig)
    if image is None:
        return []
    topics = [bag.find(f"{rig}/{side}/{image}", IMAGE, COMPRESSED) for side in SIDES]
    return [topic for topic in topics if topic is not None]


def with_sync(proposal: Proposal, bag: Bag) -> Proposal:
    """Add an offset or a tolerance of stamps if the stamps of the drive's left and right images differ."""
    given = proposal.config.sync
    topics = _image_topics(bag, "loc")
    stamps: dict[str, list[int]] = {topic.name: [] for topic in topics}
    for topic, stamp_ns, _ in bag.stream(topics):
        stamps[topic.name].append(stamp_ns)
    if len(stamps) < len(SIDES) or min(map(len, stamps.values())) < FEWEST_STAMPS:
        return proposal
    left_ns, right_ns = (np.array(side, np.int64) for side in stamps.values())
    right_ns = right_ns + round(given.right_offset_s * NS_PER_S)
    setting = _offset_or_tolerance(left_ns, right_ns, given.stamp_tolerance_ns)
    return proposal if setting is None else proposal.adding(setting)


def _offset_or_tolerance(left_ns: IntArray, right_ns: IntArray, tolerance_ns: int) -> Value | None:
    """Return the value in `sync` that pairs left and right stamps; None if no value is required or known.

    A difference within the tolerance requires no value. No setting is proposed if the differences, including
    their spread, reach half a period, because it is then unknown which right image belongs to a left image. A constant
    smaller difference is an offset of the right stamps. A varying difference requires a larger tolerance.
    """
    period_ns = float(min(np.median(np.diff(side)) for side in (left_ns, right_ns)))
    difference_ns = right_ns[nearest_stamps(left_ns, right_ns)[0]] - left_ns
    typical_ns = float(np.median(difference_ns))
    spread_ns = float(np.percentile(np.abs(difference_ns - typical_ns), 95))
    largest_ns = abs(typical_ns) + spread_ns
    if largest_ns <= below_half_period(tolerance_ns, [int(period_ns)]) or 2 * largest_ns >= period_ns:
        return None
    if spread_ns < STEADY * period_ns:
        late = f"{abs(typical_ns) / NS_PER_S:.4g} s {'late' if typical_ns > 0.0 else 'early'}"
        text = f"right stamps are {late}, within {spread_ns / NS_PER_S:.2g} s, modulo the period"
        return Value(Key("sync", "right_offset_s"), round(-typical_ns / NS_PER_S, 6), text)
    largest_s = largest_ns / NS_PER_S
    tolerance_s = max(largest_s, min(1.5 * largest_s, MAX_TOLERANCE_S))
    text = f"stamps vary by {spread_ns / NS_PER_S:.2g} s"
    return Value(Key("sync", "stamp_tolerance_s"), round(tolerance_s, 4), text)
