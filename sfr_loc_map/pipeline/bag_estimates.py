"""Estimated and true poses of a bag, and what a recorded localisation node said of its calls on /diagnostics."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag import ODOMETRY, TF, Bag, Topic
from sfr_loc_map.io.bag_poses import GROUND_TRUTH, read_odometry, read_trajectory
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.association import UPPER, Estimates, lost_by_covariance
from sfr_loc_map.metrics.consistency import STEP_SIZE
from sfr_loc_map.pipeline.call_stats import call_of

DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
TASK: Final = "localisation"


@dataclass(frozen=True, slots=True, eq=False)
class BagCalls:
    """The calls of one localisation node, by their stamps.

    Attributes:
        states: State after each call.
        steps: `(27,)` step of each call that has one.
    """

    states: dict[int, str]
    steps: dict[int, FloatArray]

    def degraded_at(self, stamps_ns: IntArray) -> Mask:
        """Return for each stamp `(N,)` whether the state of its call is degraded."""
        return np.array([self.states.get(stamp) == TrackingState.DEGRADED for stamp in stamps_ns.tolist()], np.bool_)

    def steps_at(self, stamps_ns: IntArray) -> FloatArray | None:
        """Return the step to each stamp, `(N, 27)`, NaN where there is none; None without any."""
        if not self.steps:
            return None
        unknown = np.full(STEP_SIZE, np.nan)
        return np.array([self.steps.get(stamp, unknown) for stamp in stamps_ns.tolist()]).reshape(-1, STEP_SIZE)


def read_calls(bag: Bag, odometry: Topic) -> BagCalls:
    """Read the calls of the node that published an odometry topic; none where they were not recorded.

    Raises:
        InputError: If a call cannot be read.
    """
    calls = BagCalls({}, {})
    topic = bag.find("diagnostics", DIAGNOSTICS)
    if topic is None:
        return calls
    namespace = odometry.bag_name.strip("/").removesuffix(odometry.name).strip("/")
    for _, _, message in bag.messages([topic]):
        for status in message.status:
            node = status.name.partition(":")[0].strip("/")
            if node.rpartition("/")[0] == namespace:
                _take(status, calls, topic)
    return calls


def _take(status: Any, calls: BagCalls, topic: Topic) -> None:  # noqa: ANN401 - rosbags has no types
    """Add the call that a status describes, if it is one of the localiser."""
    values = {pair.key: pair.value for pair in status.values}
    if values.get("task") != TASK:
        return
    try:
        call = call_of(values)
    except InputError as error:
        raise InputError(f"status '{status.name}' of '{topic.bag_name}' cannot be read: {error}") from error
    if call is None:
        return
    calls.states[call.record.stamp_ns] = call.record.state
    if call.record.step is not None:
        calls.steps[call.record.stamp_ns] = call.record.step


def bag_estimates(path: Path) -> Estimates:
    """Read estimated poses of a bag, with lost flags, covariances and steps.

    Raises:
        InputError: If there are none.
    """
    bag = Bag(path)
    topic = bag.find("localisation/odometry", ODOMETRY)
    if topic is None and set(bag.topics.values()) <= {ODOMETRY, TF}:  # a trajectory that was converted, no drive
        topic = bag.find("ground_truth/odometry", ODOMETRY)
    if topic is None:
        raise InputError(
            f"bag '{path}' has no topic localisation/odometry: it has {', '.join(list(bag.topics)[:8])}; give a bag "
            "with estimates, or a TUM or csv file"
        )
    odometry = read_odometry(bag, topic)
    trajectory, covariance = odometry.trajectory, odometry.covariance[:, *UPPER]
    known = np.where(covariance.any(axis=1, keepdims=True), covariance, np.nan)
    lost = lost_by_covariance(covariance)
    calls, stamps_ns = read_calls(bag, topic), trajectory.stamps_ns
    stated = known if covariance.any() else None
    return Estimates.of(trajectory, lost, calls.degraded_at(stamps_ns), stated, calls.steps_at(stamps_ns))


def bag_truth(path: Path) -> Trajectory | None:
    """Read true poses of a bag, None where it has none."""
    return read_trajectory(Bag(path), GROUND_TRUTH)
