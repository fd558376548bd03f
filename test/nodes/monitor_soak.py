"""Hours of the monitor in minutes: `make monitor-soak`.

python test/nodes/monitor_soak.py [HOURS] [--out CURVE.csv]
    truth, estimates and calls at 50 Hz go through the callbacks of a monitor node, as fast as it takes them, and each
    simulated second it may publish; exit code 1 if its memory grows by more than the poses that it keeps or it takes
    more than a tenth of a core
"""

from __future__ import annotations

import argparse
import csv
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

RATE_HZ = 50
PERIOD_NS = 1_000_000_000 // RATE_HZ
FIRST_NS = 1_000_000_000_000_000_000
SPEED_M_S = 1.0
ROW_BYTES = 64 + 240
"""Of a true pose and an estimate."""
MAX_GROWTH_MB_H = 1.2 * ROW_BYTES * RATE_HZ * 3600 / 1e6
MAX_SHARE = 0.10


@dataclass(frozen=True)
class Sample:
    """What the monitor has taken until a simulated time."""

    hours: float
    rss_mb: float
    processor_share: float


class Feed:
    """Messages of a rover that drives circles; the same objects again and again, as making them costs more."""

    def __init__(self) -> None:
        from sfr_loc_map.geometry.transform import Transform
        from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
        from sfr_loc_map.nodes.diagnostics import Level, array_msg, status_msg
        from sfr_loc_map.nodes.messages.fields import header_msg
        from sfr_loc_map.nodes.messages.pose import odometry_msg

        pose = PoseEstimate(FIRST_NS, Transform.identity(), 1e-6 * np.eye(6), TrackingState.TRACKING)
        self.truth, self.estimate = (odometry_msg(pose, "ds", "rb") for _ in range(2))
        values = {"task": "localisation", "stamp_ns": FIRST_NS, "state": "tracking", "processing_time_s": 0.05}
        self.call = array_msg(
            header_msg(FIRST_NS, ""), status_msg("localisation_node: call", Level.OK, "tracking", values)
        )
        self._stamp_of_call = next(item for item in self.call.status[0].values if item.key == "stamp_ns")

    def set(self, number: int) -> None:
        """Make the messages those of a pose."""
        stamp_ns = FIRST_NS + number * PERIOD_NS
        angle = number * SPEED_M_S / RATE_HZ / 20.0
        for message, error in ((self.truth, 0.0), (self.estimate, 0.001 * np.sin(0.1 * number))):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
            pose = message.pose.pose
            pose.position.x, pose.position.y = float(20.0 * np.sin(angle) + error), float(20.0 - 20.0 * np.cos(angle))
            pose.orientation.z, pose.orientation.w = float(np.sin(0.5 * angle)), float(np.cos(0.5 * angle))
        self._stamp_of_call.value = str(stamp_ns)


def soak(node: Any, hours: float, period_s: float) -> Iterator[Sample]:
    """Feed an active monitor; give a sample each `period_s` simulated seconds."""
    feed, process, used = Feed(), psutil.Process(), 0.0
    for second in range(round(3600.0 * hours)):
        for number in range(second * RATE_HZ, (second + 1) * RATE_HZ):
            feed.set(number)
            begin = time.thread_time()
            node._on_truth(feed.truth)
            node._on_estimate(feed.estimate)
            node._on_calls(feed.call)
            used += time.thread_time() - begin
        begin = time.thread_time()
        node._publish()
        used += time.thread_time() - begin
        if (second + 1) % period_s == 0:
            yield Sample((second + 1) / 3600.0, process.memory_info().rss / 1e6, used / (second + 1))


def memory_of(samples: list[Sample]) -> Any:
    """Return the resident memory over the simulated time."""
    from sfr_loc_map.fault_injection.soak import MemoryTrend

    return MemoryTrend([3600.0 * row.hours for row in samples], [row.rss_mb for row in samples])


def main() -> int:
    """Soak a monitor in this process."""
    parser = argparse.ArgumentParser()
    parser.add_argument("hours", type=float, nargs="?", default=8.0)
    parser.add_argument("--out", type=Path, default=Path("out/monitor-soak.csv"))
    options = parser.parse_args()
    from sfr_loc_map.nodes import environment

    environment.prepare()
    environment.isolate()
    import rclpy

    from sfr_loc_map.nodes.monitor_node import MonitorNode

    rclpy.init()
    node = MonitorNode()
    node.start()
    samples: list[Sample] = []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(["hours", "rss_mb", "processor_share"])
        for sample in soak(node, options.hours, period_s=60.0):
            samples.append(sample)
            rows.writerow([f"{sample.hours:.4f}", f"{sample.rss_mb:.2f}", f"{sample.processor_share:.4f}"])
            file.flush()
    scored = node._score.result(details=False).trajectory
    poses, share = scored.estimate_poses if scored is not None else 0, samples[-1].processor_share
    trend = memory_of(samples)
    growth, error = trend.slope()
    print(f"{poses} poses in {samples[-1].hours:.2f} h scored, {100 * share:.1f} % of a core")
    print(f"{samples[-1].rss_mb:.0f} MB, {growth:+.2f} +- {2 * error:.2f} MB/h after the warm-up")
    failure = trend.failure(MAX_GROWTH_MB_H) or ("more than a tenth of a core" if share > MAX_SHARE else "")
    print(failure or f"no more than {MAX_GROWTH_MB_H:.0f} MB/h for the poses that it keeps", flush=True)
    os._exit(int(bool(failure)))


if __name__ == "__main__":
    main()
