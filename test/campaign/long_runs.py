"""Long runs of the nodes: the growth of memory at the highest rate, and what transport adds to the processing."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import rclpy
from node_harness import LOCALISATION, Harness

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.nodes.diagnostics import Level, array_msg, status_msg
from sfr_loc_map.nodes.environment import configure_malloc
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.pose import odometry_msg
from sfr_loc_map.nodes.monitor_node import MonitorNode

WARM_UP_SHARE = 1.0 / 3.0
"""Share of a run before memory is judged: buffers fill, the allocator reaches its size."""
JUDGED_FROM_S = 540.0
"""A shorter run cannot separate slow growth from the warm-up: only a large growth fails it."""
LARGE_MB, SLOPE_LIMIT_MB_H = 40.0, 1.0
PAIRS_PER_MAP = 50
MONITOR_HZ, FIRST_NS = 50, 1_000_000_000_000_000_000
POSES_MB_H = (64 + 240) * MONITOR_HZ * 3600 / 1e6
"""Of a true pose and an estimate."""
ADDED_LIMIT_S = 0.010
"""Limit of the time that transport and conversion add to the processing (p95)."""


@dataclass(slots=True)
class MemoryTrend:
    """Resident memory over time."""

    seconds: list[float] = field(default_factory=list)
    mb: list[float] = field(default_factory=list)

    def slope(self) -> tuple[float, float]:
        """Return the slope after the warm-up and its standard error, MB/h, by least squares.

        Neighbouring values are correlated; the error is that of the means of ten equal parts, taken as independent.
        """
        begin = int(len(self.mb) * WARM_UP_SHARE)
        hours, mb = np.array(self.seconds[begin:]) / 3600.0, np.array(self.mb[begin:])
        parts = [part for part in np.array_split(np.arange(len(mb)), 10) if len(part)]
        if len(parts) < 4:
            return 0.0, np.inf
        means = np.array([(hours[part].mean(), mb[part].mean()) for part in parts])
        (slope, _), covariance = np.polyfit(*means.T, 1, cov=True)
        return float(slope), float(np.sqrt(covariance[0, 0]))

    def failure(self, limit_mb_h: float) -> str:
        """Return why the memory fails, empty if it does not: its slope lies above the limit by two standard errors."""
        grown = self.mb[-1] - self.mb[int(len(self.mb) * WARM_UP_SHARE)]
        slope, error = self.slope()
        if self.seconds[-1] < JUDGED_FROM_S:
            return f"memory has grown by {grown:.0f} MB after the warm-up" if grown > LARGE_MB else ""
        grows = slope - 2 * error > limit_mb_h
        return f"memory grows by {slope:.1f} MB/h, the limit is {limit_mb_h:g}" if grows else ""


def soak(folder: Path, minutes: float = 60.0) -> list[str]:
    """Localise in lock step, map after every 50 pairs, sample the memory of each node; return what failed."""
    begin, trends, pairs, failures = time.monotonic(), defaultdict[str, MemoryTrend](MemoryTrend), 0, []
    with Harness(folder) as harness:
        harness.wait_ready()
        while time.monotonic() - begin < 60.0 * minutes:
            harness.localise(PAIRS_PER_MAP)
            harness.map()
            harness.forget()
            pairs += PAIRS_PER_MAP
            for name in harness.nodes:
                trends[name].seconds.append(time.monotonic() - begin)
                trends[name].mb.append(harness.memory_mb(name))
    print(f"{pairs} pairs, {pairs // PAIRS_PER_MAP} maps")
    for name, trend in trends.items():
        slope, error = trend.slope()
        print(f"{name} {trend.mb[-1]:.0f} MB, {slope:+.1f} +- {2 * error:.1f} MB/h")
        failures += [f"{name}: {failure}"] if (failure := trend.failure(SLOPE_LIMIT_MB_H)) else []
    return failures


def carry_images(folder: Path, minutes: float = 10.0, rate_hz: float = 10.0, size: float = 1024) -> list[str]:
    """Send square stereo pairs through localisation (rate 0: lock step); print times, return what failed.

    What is added is the time from the publish call of the slower image to the publication of the odometry, less the
    processing time: transport, conversion, waiting, publication.
    """
    with Harness(folder, nodes=(LOCALISATION,), size=int(size)) as harness:
        harness.wait_ready()
        dropped, first = harness.health[LOCALISATION].dropped, harness.next_stamp()
        end = time.monotonic() + 60.0 * minutes
        if rate_hz:
            with harness.driving(rate_hz):
                time.sleep(60.0 * minutes)
        while not rate_hz and time.monotonic() < end:
            harness.localise()
        harness.settle(2.0)
        sent, missing = harness.pairs_since(first)
        counted = harness.health[LOCALISATION].dropped - dropped
        calls = [values for (_, _, stamp), values in harness.calls.items() if stamp > first]
    names = ("processing_time_s", "latency_transport_s", "conversion_s", "latency_receive_to_publish_s")
    times = np.array([[float(values[name]) for name in names] for values in calls if all(n in values for n in names)])
    added = times[:, 1] + times[:, 3] - times[:, 0]
    print(f"{sent} pairs sent, {sent - missing} localised, {counted} images counted as dropped")
    for name, values in zip((*names, "added_s"), (*times.T, added), strict=True):
        p50, p95 = 1e3 * np.quantile(values, (0.5, 0.95))
        print(f"{name:30}p50 {p50:.1f}, p95 {p95:.1f}, max {1e3 * values.max():.1f} ms")
    failures = [f"{missing} pairs are missing, {counted} drops were counted"] if missing > counted else []
    failures += [f"{missing} pairs lost in lock step"] if missing and not rate_hz else []
    late = float(np.quantile(added, 0.95))
    return failures + ([f"{1e3 * late:.1f} ms are added (p95)"] if late > ADDED_LIMIT_S else [])


def feed_monitor(node: Any, hours: float) -> Iterator[tuple[float, float, float]]:
    """Feed an active monitor truth, estimates and calls at 50 Hz of simulated time, as fast as it takes them.

    Yields:
        After each simulated second: which, the resident memory in MB, and the share of a core that was used.
    """
    pose = PoseEstimate(FIRST_NS, Transform.identity(), 1e-6 * np.eye(6), TrackingState.TRACKING)
    truth, estimate = (odometry_msg(pose, "ds", "rb") for _ in range(2))
    values = {"task": "localisation", "stamp_ns": FIRST_NS, "state": "tracking", "processing_time_s": 0.05}
    status = status_msg("localisation_node: call", Level.OK, "tracking", values)
    call, stamp = array_msg(header_msg(FIRST_NS, ""), status), status.values[1]
    process, used = psutil.Process(), 0.0
    for second in range(round(3600.0 * hours)):
        for number in range(second * MONITOR_HZ, (second + 1) * MONITOR_HZ):
            stamp_ns, angle = FIRST_NS + number * 10**9 // MONITOR_HZ, number / MONITOR_HZ / 20.0  # circles at 1 m/s
            stamp.value = str(stamp_ns)
            for message, error in ((truth, 0.0), (estimate, 0.001 * np.sin(0.1 * number))):
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
                position, turn = message.pose.pose.position, message.pose.pose.orientation
                position.x, position.y = float(20.0 * np.sin(angle) + error), float(20.0 - 20.0 * np.cos(angle))
                turn.z, turn.w = float(np.sin(0.5 * angle)), float(np.cos(0.5 * angle))
            begin = time.thread_time()
            node._on_truth(truth)
            node._on_estimate(estimate)
            node._on_calls(call)
            used += time.thread_time() - begin
        begin = time.thread_time()
        node._publish()
        used += time.thread_time() - begin
        yield second + 1.0, process.memory_info().rss / 1e6, used / (second + 1.0)


def soak_monitor(hours: float = 8.0) -> list[str]:
    """Feed a monitor in this process; return what failed: more memory than its poses take, a tenth of a core."""
    configure_malloc()  # as the program of the node does
    rclpy.init()
    node = MonitorNode()
    node.start()
    samples = [sample for sample in feed_monitor(node, hours) if sample[0] % 60.0 == 0.0]
    trajectory = node._score.result(details=False).trajectory
    trend = MemoryTrend([sample[0] for sample in samples], [sample[1] for sample in samples])
    slope, error = trend.slope()
    share, poses = samples[-1][2], 0 if trajectory is None else trajectory.estimate_poses
    print(f"{poses} poses scored, {100 * share:.1f} % of a core")
    print(f"{trend.mb[-1]:.0f} MB, {slope:+.2f} +- {2 * error:.2f} MB/h, of which {POSES_MB_H:.0f} for the poses")
    failure = trend.failure(1.2 * POSES_MB_H)
    node.destroy_node()
    return ([failure] if failure else []) + (["more than a tenth of a core"] if share > 0.1 else [])
