"""A made run as a feed tells it: poses with truth, calls, health, the monitor's report."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sfr_loc_map.constants import LOST_VARIANCE, NS_PER_S
from sfr_loc_map.live.updates import GraphView, PoseSample, Report, Status, StatusKind, Track, Update
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.metrics.verdicts.limits import Limits, parse_limits
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.online.monitor_score import MonitorScore

STEP_NS = NS_PER_S // 10
LIMITS = {
    "minimum_count": 5,
    "trajectory": [
        {"condition": "distance=5", "position_mean_plus_3sigma_m": 0.1, "heading_mean_plus_3sigma_deg": 0.01}
    ],
    "map": {"coverage_min": 0.8},
    "timing": {"localisation_p95_s": 1.0},
}


def limits() -> Limits:
    return parse_limits(LIMITS, "made")


def poses(count: int, begin_s: float) -> Iterator[PoseSample]:
    """Truth and estimate, 10 Hz, 0.1 m apart on an arc; the estimate scaled by 0.4 % and turned a little."""
    for number in range(count):
        angle = 0.002 * number
        truth = (20.0 * math.sin(5 * angle / 2), 20.0 * (1 - math.cos(5 * angle / 2)), 0.0)
        wobble = 0.002 * math.sin(0.7 * number)
        estimate = (truth[0] * 1.004 + wobble, truth[1] * 1.004 - wobble, wobble)
        yaw = 5 * angle / 2
        for track, place, turn in ((Track.TRUTH, truth, yaw), (Track.ESTIMATE, estimate, yaw + 0.001 * wobble)):
            quat = (0.0, 0.0, math.sin(turn / 2), math.cos(turn / 2))
            covariance = np.eye(6) * 1e-4 if track is Track.ESTIMATE else None
            yield PoseSample(track, (number + 1) * STEP_NS, place, quat, begin_s + 0.1 * number, covariance)


def lost_pose(number: int, received_s: float) -> PoseSample:
    """A pose of a localisation that is lost."""
    return PoseSample(
        Track.ESTIMATE,
        (number + 1) * STEP_NS,
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 1.0),
        received_s,
        np.eye(6) * LOST_VARIANCE,
    )


def report(count: int, received_s: float) -> Report:
    """What the monitor says of the first poses."""
    score = MonitorScore(ScoreConfig(), limits())
    for pose in poses(count, 0.0):
        if pose.covariance is None:
            score.add_truth(pose.stamp_ns, pose.position, pose.quat_xyzw)
        else:
            score.add_estimate(pose.stamp_ns, pose.position, pose.quat_xyzw, pose.covariance)
            times = {"latency_transport_s": 0.004}
            score.add_call(CallRecord(pose.stamp_ns, 0.035, "tracking", 412_000_000, 90_000_000, times))
    return Report(to_json(score.result(details=False)), received_s)


def call(number: int, received_s: float, state: str = "tracking") -> Status:
    values = {
        "task": "localisation",
        "stamp_ns": str((number + 1) * STEP_NS),
        "state": state,
        "reason": "",
        "processing_time_s": "0.0351",
        "peak_rss_bytes": "412000000",
        "latency_transport_s": "0.004",
    }
    return Status("localisation_node", StatusKind.CALL, 0, state, values, received_s)


def health(node: str, received_s: float, level: int = 0, message: str = "tracking") -> Status:
    values = {
        "lifecycle": "active",
        "resident_memory_bytes": "400000000",
        "latency_transport_p95_s": "0.0042",
        "dropped_in_transport": "3" if level else "0",
        "dropped_unpaired": "0",
    }
    return Status(node, StatusKind.HEALTH, level, message, values, received_s)


def updates(count: int, begin_s: float, *, with_report: bool = True) -> Iterator[Update]:
    """A whole run that ends at `begin_s + 0.1 * count`."""
    end_s = begin_s + 0.1 * count
    yield from poses(count, begin_s)
    yield call(count - 1, end_s)
    yield health("localisation_node", end_s)
    yield health("mapping_node", end_s, 1, "stereo pairs without a pose")
    yield health("monitor_node", end_s, 0, "scoring")
    yield GraphView(frozenset({"localisation_node", "mapping_node", "monitor_node"}), end_s, {"loc/left/image_rect": 2})
    if with_report:
        yield report(count, end_s)
