"""The truth of a bag: a topic of any type of `TRUTH_TYPES`, or the poses of a frame on /tf."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import plausible_positions
from sfr_loc_map.geometry.stamped_poses import LONGEST_GAP_S
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.bag.bag import HEADER_FIRST, Bag, Topic
from sfr_loc_map.io.bag.frames import body_of, chain_above, chain_poses, check_one_body, trajectory_of, valid_indices
from sfr_loc_map.io.bag.poses import read_frames
from sfr_loc_map.io.stamps.stamp_checks import check_stamp_order, check_truth_order
from sfr_loc_map.io.truth.config import DEFAULT_TRUTH, TruthConfig
from sfr_loc_map.io.truth.messages import TRUTH_TYPES, TrueRow, TruthReader, first_pose_ns, is_placeholder
from sfr_loc_map.io.truth.names import is_own
from sfr_loc_map.io.truth.pose_checks import possible_poses
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_types import FIX, PATH
from sfr_loc_map.topics import TRUE_POSES

_log = logging.getLogger(__name__)


def recorded_in_bag(bag: Bag, config: TruthConfig = DEFAULT_TRUTH) -> RecordedTruth:
    """Read the true poses of an opened bag; InputError if the bag has no truth.

    The topic `truth.source` has priority over the frame `truth.frame`. `truth.stamps` determines the stamps, even if
    the images of the bag are read by the times of recording.
    """
    uses_record = config.stamps == "record"
    if config.frame and not config.source:
        if uses_record:
            raise _no_times_of_recording(f"frame {config.frame} on /tf of bag '{bag.path}'")
        read_from = f"{bag.path}, frame {config.frame} on /tf"
        return RecordedTruth(_tf_poses(bag, config.frame), read_from, selected_by=(f"truth.frame={config.frame}",))
    if config.frame:
        _log.warning(f"truth.frame={config.frame} ignored: truth.source={config.source} has priority")
    bag = bag.stamped_by(config.stamps)
    topic = bag.find(config.source or TRUE_POSES, *TRUTH_TYPES)
    if topic is None:
        text = f"bag '{bag.path}' has no true poses on '{TRUE_POSES}'"
        raise InputError(f"{text}:", f"name their topic with --set truth.source=TOPIC{could_be_truth(bag)}")
    if uses_record and topic.msgtype not in HEADER_FIRST:
        raise _no_times_of_recording(f"'{topic.bag_name}' ({topic.msgtype}) of bag '{bag.path}'")
    with refusing(f"'{topic.bag_name}' of bag '{bag.path}'", "record it again"):
        poses, variances = _topic_poses(bag, topic)
    if not len(poses):
        raise InputError(f"'{topic.bag_name}' of bag '{bag.path}' has no true pose:", "record it again")
    if len(poses) > 1 and not poses.stamps_ns.any():
        raise InputError(
            f"'{topic.bag_name}' of bag '{bag.path}': all stamps of its headers are 0:",
            "--set truth.stamps=record uses the times of recording",
        )
    check_truth_order(poses.stamps_ns, f"'{topic.bag_name}' of bag '{bag.path}'")
    kind = topic.msgtype.rpartition("/")[2]
    read_from = f"{bag.path}, {topic.bag_name} ({kind}), {len(poses)} poses"
    selected_by = () if topic.bag_name.endswith(TRUE_POSES) else (f"truth.source={topic.bag_name}",)
    return RecordedTruth(poses, read_from, variances, selected_by=selected_by)


def _no_times_of_recording(where: str) -> InputError:
    """Return the error for messages of several poses, each with its own stamp."""
    return InputError(
        f"truth.stamps=record does not apply to {where}, because each pose of a message has its own stamp:",
        "omit the setting",
    )


def could_be_truth(bag: Bag) -> str:
    """Return the end of a message: the topics with a type of true poses, without estimates of the rover itself."""
    found = sorted(name for name, kind in bag.topics.items() if kind in TRUTH_TYPES and not is_own(name))
    return f"; possible topics: {', '.join(found)}" if found else ""


def _topic_poses(bag: Bag, topic: Topic) -> tuple[Trajectory, FloatArray]:
    """Return the poses of a topic and their variances `(N, 6)`, NaN where unknown."""
    where = f"'{topic.bag_name}' of bag '{bag.path}'"
    messages: Iterable[Any] = (message for _, _, message in bag.messages([topic]))
    reader = TruthReader(topic.msgtype, where)
    if topic.msgtype == PATH:  # the last path contains all earlier poses, possibly corrected
        messages = _last_path(bag, topic, where)
    if topic.msgtype == FIX:
        messages = list(messages)
        reader = _reader_of_fixes(messages, where)
    rows, bodies = list[TrueRow](), set[tuple[str, str]]()
    placeholders = 0
    for message in messages:
        bodies.add(body_of(message))
        rows += reader.rows(message)
        placeholders += topic.msgtype == FIX and is_placeholder(message)
    check_one_body(bodies, f"truth {where}")
    if placeholders:
        text = (
            f"{placeholders} fixes without a valid latitude and longitude (0 and 0, NaN, or beyond 90 and 360 deg) are "
            f"ignored, {len(rows)} are used"
        )
        _log.warning(f"truth {where}: {text}")
    stamped_poses = [(stamp_ns, pose) for stamp_ns, pose, _ in rows]
    valid = valid_indices(stamped_poses, f"truth {where}")
    poses = trajectory_of([stamped_poses[k] for k in valid])
    return poses, np.reshape([rows[k][2] for k in valid], (-1, 6))


def _reader_of_fixes(messages: Sequence[Any], where: str) -> TruthReader:
    """Return a reader of NavSatFix whose origin is the first possible fix, because a jump may be the first one."""
    from_first = TruthReader(FIX, where)
    located = [(message, row) for message in messages for row in from_first.rows(message)]
    located = [(message, row) for message, row in located if plausible_positions(np.array(row[1][:3]))]
    reader = TruthReader(FIX, where)
    if located:
        is_possible, _ = possible_poses(trajectory_of([(stamp_ns, pose) for _, (stamp_ns, pose, _) in located]))
        first_possible, _ = located[int(np.argmax(is_possible))]
        reader.set_origin(first_possible)
    return reader


def _last_path(bag: Bag, topic: Topic, where: str) -> list[Any]:
    """Return the last path that has poses, or an empty list; only this path is deserialised.

    A warning is logged if this path begins later than earlier paths, because poses of these are then missing.
    """
    last, begins_ns = None, list[int]()
    for _, _, raw in bag.stream([topic]):
        begin_ns = first_pose_ns(raw)
        if begin_ns is not None:
            begins_ns.append(begin_ns)
            last = raw
    if last is None:
        return []
    if earlier := sum(begin_ns < begins_ns[-1] for begin_ns in begins_ns):
        lost_s = (begins_ns[-1] - min(begins_ns)) / NS_PER_S
        _log.warning(
            f"truth {where}: the last path is used, but {earlier} of {len(begins_ns)} paths begin up to {lost_s:g} s "
            "before it: their earlier poses are not used; record all poses in each path, or each pose as a message"
        )
    return [bag.deserialise(topic, last)]


def _tf_poses(bag: Bag, frame: str) -> Trajectory:
    """Return the poses of a frame on /tf and /tf_static, in the root of its tree or in a parent (`PARENT:CHILD`)."""
    before, _, after = frame.rpartition(":")
    parent, child = before.strip("/"), after.strip("/")
    frames = read_frames(bag, child, parent)
    with refusing(f"/tf of bag '{bag.path}'", "choose one with truth.frame=PARENT:CHILD"):
        chain = chain_above(frames, child, parent)
    moving = [name for name in chain if not frames[name].is_static]
    if not moving or (parent and frames[chain[-1]].parent != parent):
        known = ", ".join(sorted(f"{item.parent}:{name}" for name, item in frames.items() if not item.is_static))
        raise InputError(
            f"bag '{bag.path}' has no moving transform '{frame}' on /tf: it has {known or 'none'};",
            "choose one with truth.frame=PARENT:CHILD",
        )
    where = f"/tf of bag '{bag.path}'"
    with refusing(where, "record it again"):
        for name in moving:
            rows = frames[name].rows
            valid = valid_indices(rows, f"{where}, '{name}'")
            frames[name] = replace(frames[name], rows=[rows[k] for k in valid])
            check_stamp_order(frames[name].poses.stamps_ns, f"{where}, '{name}'", strict=False)
        fastest = max(moving, key=lambda name: len(frames[name].rows))
        poses = chain_poses(frames, chain, fastest)
    count = len(frames[fastest].rows)
    skipped = count - len(poses)
    text = (
        f"{where}: {skipped} of {count} poses of '{frame}' skipped, because {' or '.join(moving)} is not recorded "
        f"before and after them within {LONGEST_GAP_S:g} s"
    )
    if not len(poses):
        raise InputError(f"{text}:", "record all transforms together")
    if skipped:
        _log.warning(text)
    return poses
