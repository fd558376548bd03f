"""Rates that the nodes carry: large images through localisation, poses through the monitor."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry

from sfr_loc_map.fault_injection.harness import LOCALISATION, MONITOR, Harness
from sfr_loc_map.fault_injection.scene import TURN, Scene
from sfr_loc_map.fault_injection.settings import CampaignSettings
from sfr_loc_map.fault_injection.soak import MemoryTrend
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.nodes import environment
from sfr_loc_map.nodes.diagnostics import Level, Value, array_msg, status_msg
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.pose import odometry_msg

ADDED_LIMIT_S = 0.010
"""Limit of the time that transport and conversion add to the processing (p95)."""
SLOPE_LIMIT_MB_H = 1.0
SAMPLE_S = 0.5
STEP_M = 0.02
ARGUMENTS = {
    LOCALISATION: ("-p", "resume_file:=''"),
    MONITOR: ("-p", "publish_period_s:=1.0", "-p", "save_period_s:=0.0"),
}
"""No files, a report once a second, as by default."""


@dataclass(frozen=True, slots=True)
class RateSettings:
    """What is published.

    Attributes:
        minutes: How long.
        rate_hz: Rate; 0: lock step, the next pair after the result of the last one.
        size: Width and height of the images.
    """

    minutes: float
    rate_hz: float
    size: int = 1024


def carry_images(settings: RateSettings, folder: Path) -> dict[str, Any]:
    """Send stereo pairs through the localisation node; return counts, times and memory for JSON.

    `added_s` is the time from the publish call of the slower image to the publication of the odometry,
    less the processing time: transport, conversion, waiting, publication.
    """
    environment.prepare()
    environment.isolate()
    scene = Scene(settings.size, settings.size)
    for index in range(TURN + 1):
        scene.loc_pair(index, 0)  # rendered beforehand, so that the publisher keeps its rate
    calls: dict[int, dict[str, str]] = {}
    trend, sent = MemoryTrend(), 0
    with Harness(folder, CampaignSettings(), ARGUMENTS, scene, nodes=(LOCALISATION,)) as harness:
        harness.wait_ready()
        dropped = harness.received.health[LOCALISATION].dropped
        first, begin = harness.rover.next_stamp(), time.monotonic()
        stamps: set[int] = set()

        def sample() -> None:
            for (_, _, stamp), values in list(harness.received.calls.items()):
                if stamp > first:
                    calls[stamp] = values
            stamps.update(stamp for stamp in list(harness.rover.sent) if stamp > first)
            trend.seconds.append(time.monotonic() - begin)
            trend.mb.append(harness.memory_mb(LOCALISATION))

        _send(harness, settings, sample)
        harness.settle(2.0)
        sample()
        sent = len(stamps)
        counted = harness.received.health[LOCALISATION].dropped
    counts = {name: counted[name] - dropped.get(name, 0) for name in counted}
    return _images_result(settings, sent, list(calls.values()), counts, trend)


def _send(harness: Harness, settings: RateSettings, sample: Callable[[], None]) -> None:
    end = time.monotonic() + 60.0 * settings.minutes
    if settings.rate_hz > 0.0:
        with harness.rover.driving(settings.rate_hz):
            while time.monotonic() < end:
                time.sleep(SAMPLE_S)
                sample()
        return
    last_sample = 0.0
    while time.monotonic() < end:
        harness.wait_pose(harness.rover.send_loc())
        if time.monotonic() - last_sample > SAMPLE_S:
            last_sample = time.monotonic()
            sample()


def _images_result(
    settings: RateSettings, sent: int, calls: Sequence[dict[str, str]], counts: dict[str, int], trend: MemoryTrend
) -> dict[str, Any]:
    def figures(name: str) -> list[float]:
        return [float(values[name]) for values in calls if name in values]

    timed = [values for values in calls if "latency_transport_s" in values and "latency_receive_to_publish_s" in values]
    added = [
        float(v["latency_transport_s"]) + float(v["latency_receive_to_publish_s"]) - float(v["processing_time_s"])
        for v in timed
    ]
    missing, slope = sent - len(calls), trend.slope()
    times = {
        "processing_s": _quantiles(figures("processing_time_s")),
        "transport_s": _quantiles(figures("latency_transport_s")),
        "conversion_s": _quantiles(figures("conversion_s")),
        "stamp_to_publish_s": _quantiles(figures("latency_stamp_to_publish_s")),
        "added_s": _quantiles(added),
    }
    failures = []
    if settings.rate_hz == 0.0 and missing:
        failures.append(f"{missing} pairs lost in lock step")
    if missing > sum(counts.values()):
        failures.append(f"{missing} pairs are missing, {sum(counts.values())} drops were counted")
    if times["added_s"]["p95"] > ADDED_LIMIT_S:
        failures.append(f"{1e3 * times['added_s']['p95']:.1f} ms are added (p95), the limit is {1e3 * ADDED_LIMIT_S:g}")
    return {
        "schema": "sfr-rate/1",
        "minutes": settings.minutes,
        "rate_hz": settings.rate_hz,
        "size": settings.size,
        "pairs_sent": sent,
        "pairs_localised": len(calls),
        "lost_states": sum(values["state"] == TrackingState.LOST.value for values in calls),
        "dropped": counts,
        "times": times,
        "memory": _memory(trend, slope),
        "failures": failures,
    }


def carry_poses(settings: RateSettings, folder: Path) -> dict[str, Any]:
    """Send estimates, truth and calls to the monitor; return counts, load and memory for JSON."""
    environment.prepare()
    environment.isolate()
    trend = MemoryTrend()
    with Harness(folder, CampaignSettings(), ARGUMENTS, nodes=(MONITOR,)) as harness:
        harness.wait_ready()
        _wait_discovered(harness)
        begin, sent, before = time.monotonic(), 0, harness.received.scored_poses
        due, last_sample, cpu_before = begin, 0.0, harness.cpu_s(MONITOR)
        while time.monotonic() - begin < 60.0 * settings.minutes:
            _send_pose(harness, sent)
            sent += 1
            due += 1.0 / settings.rate_hz
            time.sleep(max(due - time.monotonic(), 0.0))
            if time.monotonic() - last_sample > SAMPLE_S:
                last_sample = time.monotonic()
                harness.received.forget()
                trend.seconds.append(last_sample - begin)
                trend.mb.append(harness.memory_mb(MONITOR))
        took = time.monotonic() - begin
        harness.settle(4.0)
        scored, counts = harness.received.scored_poses - before, harness.received.health[MONITOR].dropped
        share = (harness.cpu_s(MONITOR) - cpu_before) / took
    slope = trend.slope()
    failures = []
    if scored != sent:
        failures.append(
            f"{scored} of {sent} poses are in the score, {sum(counts.values())} messages counted as dropped"
        )
    kept_mb_h = 304 * sent / took * 3600 / 1e6  # bytes of a true pose and an estimate
    if failure := trend.failure(SLOPE_LIMIT_MB_H + kept_mb_h):
        failures.append(failure)
    return {
        "schema": "sfr-monitor-rate/1",
        "minutes": settings.minutes,
        "rate_hz": sent / took,
        "poses_sent": sent,
        "poses_scored": scored,
        "dropped": counts,
        "processor_share": share,
        "memory": _memory(trend, slope),
        "failures": failures,
    }


def _wait_discovered(harness: Harness) -> None:
    """Send poses until the monitor has scored some: from then on it receives all of them."""
    for number in range(200):
        _send_pose(harness, number)
        time.sleep(0.05)
        if harness.received.scored_poses > 0:
            break
    harness.settle(3.0)


def _send_pose(harness: Harness, number: int) -> None:
    """Publish a true pose, its estimate and the call that made it."""
    stamp_ns = harness.rover.next_stamp()
    position = np.array([STEP_M * number, 0.0, 0.0])
    truth = PoseEstimate(stamp_ns, Transform(np.eye(3), position), 1e-6 * np.eye(6), TrackingState.TRACKING)
    error = 0.001 * np.array([np.sin(0.1 * number), np.cos(0.07 * number), 0.0])
    estimate = replace(truth, T_ds_rb=Transform(np.eye(3), position + error))
    harness.rover.publisher(Odometry, "ground_truth/odometry").publish(odometry_msg(truth, "ds", "rb"))
    harness.rover.publisher(Odometry, "localisation/odometry").publish(odometry_msg(estimate, "ds", "rb"))
    call: dict[str, Value] = {
        "task": "localisation",
        "stamp_ns": stamp_ns,
        "state": "tracking",
        "processing_time_s": 0.05,
    }
    status = status_msg("localisation_node: call", Level.OK, "tracking", call)
    harness.rover.publisher(DiagnosticArray, "/diagnostics").publish(array_msg(header_msg(stamp_ns, ""), status))


def _quantiles(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return dict.fromkeys(("p50", "p95", "max"), float("nan"))
    p50, p95 = np.quantile(values, (0.5, 0.95))
    return {"p50": float(p50), "p95": float(p95), "max": float(max(values))}


def _memory(trend: MemoryTrend, slope: tuple[float, float]) -> dict[str, Any]:
    return {"slope_mb_h": slope[0], "error_mb_h": slope[1], "seconds": trend.seconds, "mb": trend.mb}
