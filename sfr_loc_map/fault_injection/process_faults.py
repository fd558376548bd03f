"""Injected faults of processes: nodes and cameras that are killed or stopped."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from sfr_loc_map.errors import NodeError
from sfr_loc_map.fault_injection.fault import Fault, Outcome
from sfr_loc_map.fault_injection.harness import LOCALISATION, MAPPING, MONITOR, NODES, Harness
from sfr_loc_map.nodes.diagnostics import Level
from sfr_loc_map.nodes.processes import node_process

RATE_HZ = 10.0
REDELIVERY_S = 10.0
"""A subscriber receives what it missed with the next heartbeat of the writer, 3 s later at most (Fast DDS)."""


def kill_localisation(harness: Harness, outcome: Outcome) -> None:
    """Kill localisation during a drive and start it again at once."""
    received = harness.received
    unscored = len(received.odometry) - received.scored_poses
    with harness.rover.driving(RATE_HZ):
        harness.wait_poses(5)
        harness.nodes[LOCALISATION].kill()
        last = received.last_stamp
        before = threading.Thread(target=_expect_scored, args=(harness, outcome, unscored, len(received.odometry)))
        before.start()
        _restart(harness, outcome, [LOCALISATION], lambda: received.last_stamp > last)
        before.join()
        harness.wait_poses(5)
    harness.settle()
    first = min(stamp for stamp in received.odometry if stamp > last)
    missed = sum(last < stamp < first for stamp in harness.rover.sent)
    step = float(np.linalg.norm(received.position(first) - received.position(last)))
    late = max(len(received.odometry) - unscored - received.scored_poses, 0)
    outcome.lost = f"the {missed} pairs of {(first - last) * 1e-9:.1f} s without the node"
    if late:
        outcome.lost += f"; in the score the first {late} poses after it, before the monitor discovered the new node"
    outcome.figures |= {"pairs_missed": missed, "step_m": step, "poses_before_discovery": late}
    outcome.observed.append(
        f"continues {step:.3f} m from the last published pose; the covariance includes the motion since"
    )
    outcome.expect(step < 0.05, "the last known pose was not used")
    variance = float(received.odometry[first].pose.covariance[0])
    outcome.expect(variance >= 1.0, f"the covariance does not include the motion meanwhile: {variance:.2g} m^2 along x")


def kill_mapping(harness: Harness, outcome: Outcome) -> None:
    """Kill mapping with two pairs of three mapped, and again while it fuses."""
    received = harness.received
    harness.map((0, 1))
    harness.nodes[MAPPING].kill()
    _restart_mapping(harness, outcome)
    clouds = len(received.clouds)
    stamps = harness.map((0, 1))
    harness.rover.send_nav(2)
    harness.wait_until(lambda: any(s == "mapped" and t > stamps[1] for _, s, t in received.calls), "third mapped pair")
    harness.nodes[MAPPING].kill()
    published = len(received.clouds) > clouds
    _restart_mapping(harness, outcome)
    outcome.lost = f"the incomplete map, twice (2 pairs; 3 pairs, cloud {'' if published else 'not '}published)"
    outcome.observed.append("the next map was complete, monitor and test node continued")


def kill_monitor(harness: Harness, outcome: Outcome) -> None:
    """Kill the monitor during a drive."""
    received = harness.received
    with harness.rover.driving(RATE_HZ):
        harness.wait_poses(30)
        before = received.scored_poses
        harness.nodes[MONITOR].kill()
        received.report = {}
        _restart(harness, outcome, [MONITOR], lambda: received.scored_poses > 0)
        unscored = len(received.odometry) - received.scored_poses
        harness.wait_poses(10)
    harness.settle()
    # a report and the odometry that it counts are not received at the same time
    _expect_scored(harness, outcome, unscored, len(received.odometry) - 3)
    saved = json.loads(harness.saved_report.with_name("report.before.json").read_text(encoding="utf-8"))
    kept = saved.get("trajectory", {}).get("estimate_poses", 0)
    outcome.lost = f"of the score of {before} poses the {before - kept} not saved yet"
    outcome.expect(before - kept <= 2 * RATE_HZ, f"the saved report has {kept} of {before} poses")
    outcome.observed.append("localisation was not disturbed, the score started again")


def kill_all(harness: Harness, outcome: Outcome) -> None:
    """Kill all three nodes at once during a drive."""
    received = harness.received
    with harness.rover.driving(RATE_HZ):
        harness.wait_poses(5)
        for node in harness.nodes.values():
            node.send(signal.SIGKILL)
        for node in harness.nodes.values():
            node.kill()
        last = received.last_stamp
        received.report = {}
        _restart(harness, outcome, NODES, lambda: received.last_stamp > last)
        harness.wait_poses(5)
    harness.wait_connected(MONITOR)
    harness.wait_connected(MAPPING)
    harness.map()
    first = min(stamp for stamp in received.odometry if stamp > last)
    missed = sum(last < stamp < first for stamp in harness.rover.sent)
    outcome.lost = f"the {missed} pairs of {(first - last) * 1e-9:.1f} s without nodes; the score until then"
    outcome.observed.append("all three work again, a map was made")


def stop(name: str, harness: Harness, outcome: Outcome) -> None:
    """Stop a node for a while during a drive, then continue it."""
    received = harness.received
    unscored = len(received.odometry) - received.scored_poses
    dropped = received.dropped(LOCALISATION)
    first = harness.rover.next_stamp()
    node = harness.nodes[name]
    with harness.rover.driving(RATE_HZ):
        harness.wait_poses(5)
        node.send(signal.SIGSTOP)
        time.sleep(harness.settings.stop_s)
        last = harness.rover.next_stamp()
        node.send(signal.SIGCONT)
        if name == LOCALISATION:
            outcome.recovered(
                harness.wait_until(lambda: received.last_stamp > last, "odometry of a pair sent after the stop"),
                harness.settings.restart_limit_s,
                "catching up",
            )
        else:
            begin = time.monotonic()
            harness.wait_until(lambda: received.health[name].received_s > begin, f"health of {name}")
            outcome.recover_s = time.monotonic() - begin
        harness.wait_poses(3)
    _expect_scored(harness, outcome, unscored)
    if name == MONITOR:
        outcome.recover_s = outcome.figures["score_late_s"]
    pairs = harness.pairs_since(first)
    counted = received.dropped(LOCALISATION) - dropped
    outcome.observed.append(f"{pairs}, {counted} images counted as dropped")
    outcome.figures |= {"sent": pairs.sent, "missing": pairs.missing, "counted": counted}
    outcome.lost = pairs.lost
    outcome.expect(counted >= pairs.missing, f"{pairs.missing} pairs are missing, {counted} drops were counted")
    if name != LOCALISATION:
        outcome.expect(not pairs.missing, f"localisation lost {pairs.missing} pairs")


def publisher_dies(harness: Harness, outcome: Outcome) -> None:
    """Kill the process that publishes the images; another one replaces it."""
    received = harness.received
    camera = node_process("fault_injection.camera", [str(RATE_HZ)], harness.folder)
    camera.start()
    try:
        harness.wait_poses(6)
        camera.kill()
        harness.wait_until(lambda: received.health[LOCALISATION].level is Level.STALE, "STALE health")
        outcome.observed.append("STALE after 5 s without images")
        begin = time.monotonic()
        camera.start()
        harness.wait_poses(1)
        outcome.recover_s = time.monotonic() - begin
        harness.wait_until(lambda: received.health[LOCALISATION].level is not Level.STALE, "health without STALE")
        outcome.observed.append("continued with the images of the next publisher (time includes its start)")
    finally:
        camera.kill()
    harness.localise(3)


def _restart_mapping(harness: Harness, outcome: Outcome) -> None:
    begin = time.monotonic()
    harness.nodes[MAPPING].start()
    harness.wait_connected(MAPPING)
    outcome.recovered(time.monotonic() - begin, harness.settings.restart_limit_s, "the restart")
    harness.map()


def _restart(harness: Harness, outcome: Outcome, names: Sequence[str], works: Callable[[], object]) -> None:
    """Start nodes; measure the time and the CPU time until they work."""
    begin = time.monotonic()
    for name in names:
        harness.nodes[name].start()
    harness.wait_until(works, "the first result after the restart")
    outcome.recovered(time.monotonic() - begin, harness.settings.restart_limit_s, "restart to first result")
    outcome.figures["processor_s"] = {name: harness.cpu_s(name) for name in names}


def _expect_scored(harness: Harness, outcome: Outcome, unscored: int, published: int | None = None) -> None:
    """Compare the poses of the score with those that were published: an acknowledged message must not be lost."""
    received = harness.received
    if published is None:
        harness.settle()
        published = len(received.odometry)
    try:
        late_s = harness.wait_until(lambda: unscored + received.scored_poses >= published, "score", REDELIVERY_S)
    except NodeError:
        late_s = REDELIVERY_S
    lost = max(published - unscored - received.scored_poses, 0)
    outcome.figures |= {"published_not_scored": lost, "score_late_s": late_s}
    outcome.expect(not lost, f"{lost} poses that were published are not in the monitor's score")


FAULTS = (
    Fault(
        "kill-localisation",
        "kill -9 of localisation in a drive at 10 Hz, restarted at once",
        "first odometry in time; continues at the last published pose; every published pose is in the score",
        kill_localisation,
    ),
    Fault(
        "kill-mapping",
        "kill -9 of mapping during a map, then while it fuses the cloud",
        "subscribes in time; the incomplete map is lost, the next is complete; no node waits for the missing cloud",
        kill_mapping,
    ),
    Fault(
        "kill-monitor",
        "kill -9 of the monitor in a drive",
        "scores again in time; localisation is not disturbed",
        kill_monitor,
    ),
    Fault(
        "kill-all",
        "kill -9 of all three nodes at once in a drive",
        "first odometry in time; all three work again",
        kill_all,
    ),
    Fault(
        "stop-localisation",
        "SIGSTOP of localisation in a drive, SIGCONT later",
        "empties its queues and catches up; every pair is localised or counted as dropped",
        partial(stop, LOCALISATION),
    ),
    Fault(
        "stop-mapping",
        "SIGSTOP of mapping in a drive, SIGCONT later",
        "localisation is not disturbed",
        partial(stop, MAPPING),
    ),
    Fault(
        "stop-monitor",
        "SIGSTOP of the monitor in a drive, SIGCONT later",
        "localisation is not disturbed; every published pose is in the score afterwards",
        partial(stop, MONITOR),
    ),
    Fault(
        "publisher-dies",
        "kill -9 of the process that publishes the images; another one starts",
        "health STALE after 5 s; continues with the next publisher",
        publisher_dies,
    ),
)
