"""Processes that are killed or stopped: the nodes, and what publishes to them."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from sfr_loc_map.errors import NodeError
from sfr_loc_map.fault_injection.harness import LOCALISATION, MAPPING, MONITOR, NODES, Bench
from sfr_loc_map.fault_injection.node_process import NodeProcess
from sfr_loc_map.fault_injection.outcome import Fault, Outcome

RATE_HZ = 10.0
HEARTBEATS_S = 10.0


def kill_localisation(bench: Bench, outcome: Outcome) -> None:
    """Kill localisation in the middle of a drive and start it again at once."""
    unheard = len(bench.odometry) - bench.monitored
    with bench.driving(RATE_HZ):
        _await_odometry(bench, 5)
        bench.nodes[LOCALISATION].kill()
        last = max(bench.odometry)
        before = threading.Thread(target=_compare, args=(bench, outcome, unheard, len(bench.odometry)))
        before.start()
        _restart(bench, outcome, [LOCALISATION], lambda: max(bench.odometry) > last)
        before.join()
        _await_odometry(bench, 5)
    bench.settle()
    first = min(stamp for stamp in bench.odometry if stamp > last)
    missed = sum(last < stamp < first for stamp in bench.sent)
    step = float(np.linalg.norm(bench.position(first) - bench.position(last)))
    late = max(len(bench.odometry) - unheard - bench.monitored, 0)
    outcome.lost = f"the {missed} pairs of {(first - last) * 1e-9:.1f} s without the node"
    if late:
        outcome.lost += f"; the first {late} poses after it for the monitor, which discovered the new node so late"
    outcome.figures |= {"pairs_missed": missed, "step_m": step, "poses_before_discovery": late}
    outcome.observed.append(f"goes on {step:.3f} m from the last pose it had published, with a covariance that says so")
    outcome.expect(step < 0.05, "the pose known last was forgotten")
    variance = float(bench.odometry[first][1].pose.covariance[0])
    outcome.expect(variance >= 1.0, f"what was driven meanwhile is not in the covariance: {variance:.2g} m^2 along x")


def kill_mapping(bench: Bench, outcome: Outcome) -> None:
    """Kill mapping with two pairs of three mapped, and again while it fuses."""
    bench.map((0, 1))
    bench.nodes[MAPPING].kill()
    _restart_mapping(bench, outcome)
    clouds = len(bench.clouds)
    stamps = bench.map((0, 1))
    bench.send_nav(2)
    bench.until(lambda: any(s == "mapped" and t > stamps[1] for _, s, t in bench.calls), "third mapped pair")
    bench.nodes[MAPPING].kill()
    came = len(bench.clouds) - clouds
    _restart_mapping(bench, outcome)
    outcome.lost = f"the set begun, twice (2 pairs; 3 pairs whose cloud {'had' if came else 'had not'} been published)"
    outcome.observed.append("the next set was mapped whole, monitor and test node went on")


def kill_monitor(bench: Bench, outcome: Outcome) -> None:
    """Kill the monitor in the middle of a drive."""
    with bench.driving(RATE_HZ):
        _await_odometry(bench, 30)
        before = bench.monitored
        bench.nodes[MONITOR].kill()
        bench.report = {}
        _restart(bench, outcome, [MONITOR], lambda: bench.monitored > 0)
        unheard = len(bench.odometry) - bench.monitored
        _await_odometry(bench, 10)
    bench.settle()
    # a report and the odometry that it counts are not heard at the same moment
    _compare(bench, outcome, unheard, len(bench.odometry) - 3)
    saved = json.loads(bench.saved_report.with_name("report.before.json").read_text(encoding="utf-8"))
    kept = saved.get("trajectory", {}).get("estimate_poses", 0)
    outcome.lost = f"of the score of {before} poses before what was not saved yet: {before - kept}"
    outcome.expect(before - kept <= 2 * RATE_HZ, f"the saved report has {kept} of {before} poses")
    outcome.observed.append("localisation was not disturbed, the score began anew")


def kill_all(bench: Bench, outcome: Outcome) -> None:
    """Kill all three nodes at once in the middle of a drive."""
    with bench.driving(RATE_HZ):
        _await_odometry(bench, 5)
        for node in bench.nodes.values():
            node.send(signal.SIGKILL)
        for node in bench.nodes.values():
            node.kill()
        last = max(bench.odometry)
        bench.report = {}
        _restart(bench, outcome, NODES, lambda: max(bench.odometry) > last)
        _await_odometry(bench, 5)
    bench.wait_listening(MONITOR)
    bench.wait_listening(MAPPING)
    bench.map()
    first = min(stamp for stamp in bench.odometry if stamp > last)
    missed = sum(last < stamp < first for stamp in bench.sent)
    outcome.lost = f"the {missed} pairs of {(first - last) * 1e-9:.1f} s without nodes; the score until then"
    outcome.observed.append("all three work again, a map was made")


def stop(name: str, bench: Bench, outcome: Outcome) -> None:
    """Stop a node for a while in the middle of a drive, and let it go on."""
    unheard = len(bench.odometry) - bench.monitored
    dropped = _dropped(bench)
    first = bench.next_stamp()
    node = bench.nodes[name]
    with bench.driving(RATE_HZ):
        _await_odometry(bench, 5)
        node.send(signal.SIGSTOP)
        time.sleep(bench.settings.stop_s)
        last = bench.next_stamp()
        node.send(signal.SIGCONT)
        if name == LOCALISATION:
            outcome.recovered(
                bench.until(lambda: max(bench.odometry) > last, "odometry of a pair sent after the stop"),
                bench.settings.restart_limit_s,
                "the way back to the present",
            )
        else:
            begin = time.monotonic()
            bench.until(lambda: bench.health[name][0] > begin, f"health of {name}")
            outcome.recover_s = time.monotonic() - begin
        _await_odometry(bench, 3)
    _compare(bench, outcome, unheard)
    if name == MONITOR:
        outcome.recover_s = outcome.figures["score_late_s"]
    sent = [stamp for stamp in bench.sent if stamp > first]
    missing = [stamp for stamp in sent if stamp not in bench.odometry]
    counted = _dropped(bench) - dropped
    outcome.observed.append(
        f"{len(sent)} pairs sent, {len(sent) - len(missing)} localised, {counted} pictures counted as dropped"
    )
    outcome.figures |= {"sent": len(sent), "missing": len(missing), "counted": counted}
    outcome.lost = f"{len(missing)} pairs" if missing else "nothing"
    outcome.expect(counted >= len(missing), f"{len(missing)} pairs are missing, {counted} drops were counted")
    if name != LOCALISATION:
        outcome.expect(not missing, f"localisation lost {len(missing)} pairs by it")


def publisher_dies(bench: Bench, outcome: Outcome) -> None:
    """Kill the process that publishes the pictures; another one takes its place."""
    camera = NodeProcess("fault_injection.camera", [str(RATE_HZ)], bench.folder, {})
    camera.start()
    try:
        count = len(bench.odometry)
        bench.until(lambda: len(bench.odometry) > count + 5, "odometry")
        camera.kill()
        bench.until(lambda: "nothing came" in bench.health[LOCALISATION][2], "STALE health")
        outcome.observed.append("STALE after 5 s of silence")
        count, begin = len(bench.odometry), time.monotonic()
        camera.start()
        bench.until(lambda: len(bench.odometry) > count, "odometry")
        outcome.recover_s = time.monotonic() - begin
        bench.until(lambda: "nothing came" not in bench.health[LOCALISATION][2], "health without STALE")
        outcome.observed.append("went on with the next publisher's pictures (time with its start)")
    finally:
        camera.kill()
    bench.localise(3)


def _restart_mapping(bench: Bench, outcome: Outcome) -> None:
    begin = time.monotonic()
    bench.nodes[MAPPING].start()
    bench.wait_listening(MAPPING)
    outcome.recovered(time.monotonic() - begin, bench.settings.restart_limit_s, "the restart")
    bench.map()


def _restart(bench: Bench, outcome: Outcome, names: Sequence[str], works: Callable[[], object]) -> None:
    """Start nodes and measure the time until they work, and the processor's time until then."""
    begin = time.monotonic()
    for name in names:
        bench.nodes[name].start()
    bench.until(works, "the first result after the restart")
    outcome.recovered(time.monotonic() - begin, bench.settings.restart_limit_s, "restart to first result")
    outcome.figures["processor_s"] = {name: bench.nodes[name].processor_s for name in names}


def _await_odometry(bench: Bench, count: int) -> None:
    goal = len(bench.odometry) + count
    bench.until(lambda: len(bench.odometry) >= goal, "odometry")


def _dropped(bench: Bench) -> int:
    values = bench.health[LOCALISATION][3]
    return sum(int(value) for name, value in values.items() if name.startswith("dropped_"))


def _compare(bench: Bench, outcome: Outcome, unheard: int, published: int | None = None) -> None:
    """Hold the score's poses against those that were published: what was acknowledged must not be lost.

    What a reader missed while it was stopped it gets with the writer's next heartbeat, 3 s later at most (Fast DDS).
    """
    if published is None:
        bench.settle()
        published = len(bench.odometry)
    try:
        late_s = bench.until(lambda: unheard + bench.monitored >= published, "score", HEARTBEATS_S)
    except NodeError:
        late_s = HEARTBEATS_S
    lost = max(published - unheard - bench.monitored, 0)
    outcome.figures |= {"published_not_scored": lost, "score_late_s": late_s}
    outcome.expect(not lost, f"{lost} poses that were published are not in the monitor's score")


FAULTS = (
    Fault(
        "kill-localisation",
        "kill -9 of localisation in a drive at 10 Hz, started again at once",
        "first odometry in time; goes on at the pose published last; every pose published is in the score",
        kill_localisation,
    ),
    Fault(
        "kill-mapping",
        "kill -9 of mapping within a set of pairs, then in mid-cloud while it fuses",
        "listens again in time; the set begun is lost, the next is whole; nobody waits for the missing cloud",
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
        "first odometry in time; all three work again without help",
        kill_all,
    ),
    Fault(
        "stop-localisation",
        "SIGSTOP of localisation in a drive, SIGCONT later",
        "works off what the queues held and is back in the present; every pair is localised or counted as dropped",
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
        "localisation is not disturbed; every pose published is in the score afterwards",
        partial(stop, MONITOR),
    ),
    Fault(
        "publisher-dies",
        "kill -9 of the process that publishes the pictures; another one begins",
        "health STALE after 5 s; goes on with the next publisher",
        publisher_dies,
    ),
)
