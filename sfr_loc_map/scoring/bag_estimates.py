"""Estimated poses of a bag, with the calls that the localisation node published on `<node>/call`."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.calls.call_message import decode_call
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.calls.growing_calls import stats_of
from sfr_loc_map.errors import InputError, naming
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.poses import read_odometry
from sfr_loc_map.io.truth.messages import TRUTH_TYPES
from sfr_loc_map.message_types import ODOMETRY, STRING, TF
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import ESTIMATE, NAV_POSE, TRUE_POSES, call_topic

CALLS = call_topic(Task.LOCALISATION)


class BagEstimate(NamedTuple):
    """The estimated poses and the calls of a bag."""

    trajectory: Trajectory
    covariance: FloatArray  #: Published covariances `(N, 6, 6)` in ROS order (m^2, rad^2).
    calls: CallStats | None  #: Calls with the times that the node stated; None if the bag has no calls.

    @property
    def all_calls(self) -> list[CallStats]:
        """The calls as a list; empty if the bag has no calls."""
        return [] if self.calls is None else [self.calls]


def read_bag_estimate(path: Path) -> BagEstimate:
    """Read the estimated poses of a bag; raise InputError if the bag has none."""
    bag = Bag(path)
    topic = bag.find(ESTIMATE, ODOMETRY)
    if topic is None and set(bag.topics.values()) <= {ODOMETRY, TF}:  # a converted trajectory, not a drive
        topic = bag.find(TRUE_POSES, ODOMETRY)
    if topic is None:
        raise _without_estimates(bag)
    trajectory, covariances = read_odometry(bag, topic)
    calls = _calls_of(bag, topic)
    stats = stats_of(calls, stated_tasks=(Task.LOCALISATION,)) if calls else None
    return BagEstimate(trajectory, covariances, stats)


def _without_estimates(bag: Bag) -> InputError:
    """Return the error of a bag without the topic of estimates, with the command that reads another topic."""
    advice = "give a bag with estimates, or a TUM or csv file"
    others = (name for name, kind in sorted(bag.topics.items()) if kind in TRUTH_TYPES)
    topic = next((name for name in others if not name.endswith((NAV_POSE, TRUE_POSES))), None)
    if topic is not None:
        convert = f"sfr convert '{bag.path}' estimate.tum --remap {topic}:={TRUE_POSES}"
        advice = f"write the estimates of another topic, such as {topic}, to a file, and score this file: {convert}"
    found = ", ".join(list(bag.topics)[:8])
    return InputError(f"bag '{bag.path}' has no topic {ESTIMATE}: it has {found};", advice)


def _calls_of(bag: Bag, odometry: Topic) -> list[CallRecord]:
    topic = Topic(CALLS, odometry.bag_name.removesuffix(odometry.name) + CALLS, STRING)
    if bag.topics.get(topic.bag_name) != STRING:
        return []
    with naming(f"'{topic.bag_name}'"):
        return [decode_call(message.data, Task.LOCALISATION) for _, _, message in bag.messages([topic])]
