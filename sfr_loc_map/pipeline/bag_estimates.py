"""Estimated poses of a bag, with what the recorded localisation node said of its calls on /diagnostics.

A module of its own: the library of the bags is loaded for a bag only.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag import ODOMETRY, Bag, Topic, read_odometry
from sfr_loc_map.io.bag_frames import TF
from sfr_loc_map.metrics.association import UPPER, Estimates, lost_by_covariance
from sfr_loc_map.pipeline.call_stats import CallRecord, call_of, stats_of

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


def bag_estimates(path: Path) -> Estimates:
    """Read estimated poses of a bag, with lost flags, covariances and steps."""
    bag = Bag(path)
    topic = bag.find("localisation/odometry", ODOMETRY)
    if topic is None and set(bag.topics.values()) <= {ODOMETRY, TF}:  # a trajectory that was converted, no drive
        topic = bag.find("ground_truth/odometry", ODOMETRY)
    if topic is None:
        raise InputError(
            f"bag '{path}' has no topic localisation/odometry: it has {', '.join(list(bag.topics)[:8])}; give a bag "
            "with estimates, or a TUM or csv file"
        )
    trajectory, covariances = read_odometry(bag, topic)
    covariance = covariances[:, *UPPER]
    known = np.where(covariance.any(axis=1, keepdims=True), covariance, np.nan) if covariance.any() else None
    calls = _calls_of(bag, topic)
    said = stats_of(calls).estimates(trajectory) if calls else Estimates.of(trajectory)
    return replace(said, lost=lost_by_covariance(covariance), covariance=known)


def _calls_of(bag: Bag, odometry: Topic) -> list[CallRecord]:
    topic = bag.find("diagnostics", DIAGNOSTICS)
    if topic is None:
        return []
    namespace = odometry.bag_name.strip("/").removesuffix(odometry.name).strip("/")
    calls = []
    for _, _, message in bag.messages([topic]):
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            node = status.name.partition(":")[0].strip("/")
            if node.rpartition("/")[0] != namespace or values.get("task") != "localisation":
                continue
            try:
                call = call_of(values)
            except InputError as error:
                raise InputError(f"status '{status.name}' of '{topic.bag_name}' cannot be read: {error}") from error
            if call is not None:
                calls.append(call.record)
    return calls
