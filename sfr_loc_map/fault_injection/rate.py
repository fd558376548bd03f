"""What the nodes carry: large pictures at a rate through localisation, poses at a rate through the monitor."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry

from sfr_loc_map.fault_injection.harness import LOCALISATION, MONITOR, Bench
from sfr_loc_map.fault_injection.outcome import CampaignSettings
from sfr_loc_map.fault_injection.scene import TURN, Scene
from sfr_loc_map.fault_injection.soak import MemoryTrend
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.nodes.diagnostics.key_values import Level, Value, array_msg, status_msg
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.pose import odometry_msg
from sfr_loc_map.nodes.process import environment

ADDED_LIMIT_S = 0.010
"""What transport and conversion may add to the processing (p95)."""
SLOPE_LIMIT_MB_H = 1.0
SAMPLE_S = 0.5
STEP_M = 0.02
USUAL = {
    LOCALISATION: ("-p", "resume_file:=''"),
    MONITOR: ("-p", "publish_period_s:=1.0", "-p", "save_period_s:=0.0"),
}
"""Nothing is kept in files, reports once a second, as by default."""


@dataclass(frozen=True, slots=True)
class RateSettings:
    """What is sent.

    Attributes:
        minutes: How long.
        rate_hz: How often; 0: in lock step, the next pair when the last one is answered.
        size: Width and height of the pictures.
    """

    minutes: float
    rate_hz: float
    size: int = 1024


def carry_images(settings: RateSettings, folder: Path) -> dict[str, Any]:
    """Send stereo pairs through the localisation node; return what came of it.

    `added_s` is the time from the publisher's publish call of the slower picture to the publication of the odometry,
    less the processing time: transport, conversion, waiting, publication.
    """
    environment.prepare()
    environment.isolate()
    scene = Scene(settings.size, settings.size)
    for index in range(TURN + 1):
        scene.loc_pair(index, 0)  # rendered before, so that the sender keeps its rate
    calls: dict[int, dict[str, str]] = {}
    trend, sent = MemoryTrend(), 0
    with Bench(folder, CampaignSettings(), USUAL, scene, nodes=(LOCALISATION,)) as bench:
        bench.wait_ready()
        dropped = _drops(bench)
        first, begin = bench.next_stamp(), time.monotonic()
        stamps: set[int] = set()

        def look() -> None:
            for (_, _, stamp), (_, values) in list(bench.calls.items()):
                if stamp > first:
                    calls[stamp] = values
            stamps.update(stamp for stamp in list(bench.sent) if stamp > first)
            trend.seconds.append(time.monotonic() - begin)
            trend.mb.append(bench.memory_mb(LOCALISATION))

        _send(bench, settings, look)
        bench.settle(2.0)
        look()
        sent = len(stamps)
        counted = _drops(bench)
    counts = {name: counted[name] - dropped.get(name, 0) for name in counted}
    return _pictures_result(settings, sent, list(calls.values()), counts, trend)


def _send(bench: Bench, settings: RateSettings, look: Callable[[], None]) -> None:
    end = time.monotonic() + 60.0 * settings.minutes
    if settings.rate_hz > 0.0:
        with bench.driving(settings.rate_hz):
            while time.monotonic() < end:
                time.sleep(SAMPLE_S)
                look()
        return
    looked = 0.0
    while time.monotonic() < end:
        bench.await_pose(bench.send_loc())
        if time.monotonic() - looked > SAMPLE_S:
            looked = time.monotonic()
            look()


def _pictures_result(
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
    """Send estimates, truth and calls to the monitor; return what came of it."""
    environment.prepare()
    environment.isolate()
    trend = MemoryTrend()
    with Bench(folder, CampaignSettings(), USUAL, nodes=(MONITOR,)) as bench:
        bench.wait_ready()
        _await_heard(bench)
        begin, sent, known = time.monotonic(), 0, bench.monitored
        due, looked, used = begin, 0.0, bench.nodes[MONITOR].processor_s
        while time.monotonic() - begin < 60.0 * settings.minutes:
            _send_pose(bench, sent)
            sent += 1
            due += 1.0 / settings.rate_hz
            time.sleep(max(due - time.monotonic(), 0.0))
            if time.monotonic() - looked > SAMPLE_S:
                looked = time.monotonic()
                bench.forget()
                trend.seconds.append(looked - begin)
                trend.mb.append(bench.memory_mb(MONITOR))
        took = time.monotonic() - begin
        bench.settle(4.0)
        scored, counts = bench.monitored - known, _drops(bench, MONITOR)
        share = (bench.nodes[MONITOR].processor_s - used) / took
    slope = trend.slope()
    failures = []
    if scored != sent:
        failures.append(
            f"{scored} of {sent} poses are in the score, {sum(counts.values())} messages counted as dropped"
        )
    if failure := trend.failure(SLOPE_LIMIT_MB_H):
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


def _await_heard(bench: Bench) -> None:
    """Send poses until the monitor has scored some: from then on it hears all of them."""
    for number in range(200):
        _send_pose(bench, number)
        time.sleep(0.05)
        if bench.monitored > 0:
            break
    bench.settle(3.0)


def _send_pose(bench: Bench, number: int) -> None:
    """Publish a true pose, its estimate and the call that made it."""
    stamp_ns = bench.next_stamp()
    at = np.array([STEP_M * number, 0.0, 0.0])
    truth = PoseEstimate(stamp_ns, Transform(np.eye(3), at), 1e-6 * np.eye(6), TrackingState.TRACKING)
    off = 0.001 * np.array([np.sin(0.1 * number), np.cos(0.07 * number), 0.0])
    estimate = replace(truth, T_ds_rb=Transform(np.eye(3), at + off))
    bench.publisher(Odometry, "ground_truth/odometry").publish(odometry_msg(truth, "ds", "rb"))
    bench.publisher(Odometry, "localisation/odometry").publish(odometry_msg(estimate, "ds", "rb"))
    call: dict[str, Value] = {
        "task": "localisation",
        "stamp_ns": stamp_ns,
        "state": "tracking",
        "processing_time_s": 0.05,
    }
    status = status_msg("localisation_node: call", Level.OK, "tracking", call)
    bench.publisher(DiagnosticArray, "/diagnostics").publish(array_msg(header_msg(stamp_ns, ""), status))


def _drops(bench: Bench, node: str = LOCALISATION) -> dict[str, int]:
    values = bench.health[node][3]
    return {name: int(value) for name, value in values.items() if name.startswith("dropped_")}


def _quantiles(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return dict.fromkeys(("p50", "p95", "max"), float("nan"))
    p50, p95 = np.quantile(values, (0.5, 0.95))
    return {"p50": float(p50), "p95": float(p95), "max": float(max(values))}


def _memory(trend: MemoryTrend, slope: tuple[float, float]) -> dict[str, Any]:
    return {"slope_mb_h": slope[0], "error_mb_h": slope[1], "seconds": trend.seconds, "mb": trend.mb}
