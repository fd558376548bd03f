"""The faults of the campaign as functions; the first line of a docstring has the fault and the expected result."""

from __future__ import annotations

import argparse
import json
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

from campaigns import malformed_messages as malformed
from campaigns.node_harness import LOCALISATION, MAPPING, MONITOR, NODES, Harness
from campaigns.own_domain import in_own_domain
from sfr_loc_map.errors import NodeError, SfrError
from sfr_loc_map.ros.pose_messages import covariance_of, odometry_row

RATE_HZ = 10.0
RESTART_LIMIT_S = 3.0
"""Largest time from the restart of a killed node to its first result, s."""
STOP_S = 10.0
REDELIVERY_S = 10.0
"""Patience for missed messages, s. They are resent with the next heartbeat, within 3 s (Fast DDS)."""
GROWTH_MB = 100.0
"""Largest allowed memory growth of a node by the messages, MB."""
TASK_OF_NODE = {LOCALISATION: "loc", MAPPING: "nav"}


@dataclass
class Row:
    """Observations of a fault: recovery is the time from its end to the first valid result; a pass has no failures."""

    name: str
    fault: str
    observed: list[str] = field(default_factory=list)
    lost: str = "nothing"
    recover_s: float | None = None
    failures: list[str] = field(default_factory=list)
    verdict: str = "pass"

    def expect(self, condition: object, text: str) -> None:
        """Record a failure with `text` unless the condition holds."""
        if not condition:
            self.failures.append(text)

    def recovered(self, seconds: float, limit_s: float, what: str) -> None:
        """Record the recovery time and compare it with the limit."""
        self.recover_s = max(self.recover_s or 0.0, seconds)
        self.expect(seconds <= limit_s, f"{what} took {seconds:.1f} s, the limit is {limit_s:g} s")


def kill(names: Sequence[str], harness: Harness, row: Row) -> None:
    """kill -9 during a drive at 10 Hz, then a restart: results in time, localisation resumes at its last pose."""
    with harness.driving(RATE_HZ):
        harness.wait_poses(30 if MONITOR in names else 5)
        scored = harness.scored_poses
        for name in names:
            harness.kill(name)
        last = max(harness.odometry)
        if MONITOR in names:
            harness.report = {}
        begin = time.monotonic()
        for name in names:
            harness.nodes[name].start()
        works = (lambda: max(harness.odometry) > last) if LOCALISATION in names else (lambda: harness.scored_poses > 0)
        harness.wait(works, "the first result after the restart")
        row.recovered(time.monotonic() - begin, RESTART_LIMIT_S, "restart to first result")
        harness.wait_poses(10)
    harness.settle()
    if LOCALISATION in names:
        first = min(stamp for stamp in harness.odometry if stamp > last)
        missed = sum(last < stamp < first for stamp in harness.sent)
        row.lost = f"the {missed} pairs of {(first - last) * 1e-9:.1f} s without the node"
        (x, y, z), before = odometry_row(harness.odometry[first])[1], odometry_row(harness.odometry[last])[1]
        step = sum((a - b) ** 2 for a, b in zip((x, y, z), before, strict=True)) ** 0.5
        row.observed.append(f"continues {step:.3f} m from the last published pose")
        row.expect(step < 0.05, "the last known pose was not used")
        variance = covariance_of(harness.odometry[first])[0, 0]
        # half of unseen_speed_m_s, because the saved pose may be later than the last received pose
        unseen_m = 0.5e-9 * (first - last)
        row.expect(variance >= unseen_m**2, f"the motion is not in the covariance: {variance:.2g} m^2 along x")
    elif MONITOR in names:
        saved = json.loads(harness.saved_report.with_name("report.before.json").read_text(encoding="utf-8"))
        kept = (saved.get("association") or {}).get("estimate_poses", 0)
        row.lost = f"of the score of {scored} poses the {scored - kept} not saved yet"
        row.expect(scored - kept <= 2 * RATE_HZ, f"the saved report has {kept} of {scored} poses")
    for name in names:
        harness.wait_connected(name)
    if MAPPING in names:
        harness.map()


def kill_mapping(harness: Harness, row: Row) -> None:
    """kill -9 of mapping during a map and during the fusion: the incomplete map is lost, the next map is complete."""
    for fuses in (False, True):
        harness.map((0, 1))
        if fuses:
            third = (MAPPING, "mapped", harness.send_nav(2))
            harness.wait(lambda third=third: third in harness.calls, "third mapped pair")
        harness.kill(MAPPING)
        begin = time.monotonic()
        harness.nodes[MAPPING].start()
        harness.wait_connected(MAPPING)
        row.recovered(time.monotonic() - begin, RESTART_LIMIT_S, "the restart")
        harness.map()
    row.lost = "the incomplete map, twice"


def stop(name: str, harness: Harness, row: Row, seconds: float = STOP_S) -> None:
    """SIGSTOP during a drive, then SIGCONT: every pair is localised or counted, every published pose is scored."""
    dropped, first = harness.health[LOCALISATION].dropped, harness.next_stamp()
    unscored, node = len(harness.odometry) - harness.scored_poses, harness.nodes[name]
    with harness.driving(RATE_HZ):
        harness.wait_poses(5)
        node.send(signal.SIGSTOP)
        time.sleep(seconds)
        last = harness.next_stamp()
        node.send(signal.SIGCONT)
        caught_up = harness.wait(lambda: max(harness.odometry) > last, "odometry of a pair sent after the stop")
        row.recovered(caught_up, RESTART_LIMIT_S, "catching up")
        harness.wait_poses(3)
    harness.settle()
    published = len(harness.odometry)
    try:
        harness.wait(lambda: unscored + harness.scored_poses >= published, "score", REDELIVERY_S)
    except NodeError:
        row.failures.append(f"{published - unscored - harness.scored_poses} published poses are not in the score")
    _count(harness, row, first, dropped)
    row.expect(name == LOCALISATION or row.lost == "nothing", f"localisation lost {row.lost}")


def _count(harness: Harness, row: Row, first_ns: int, dropped: int) -> None:
    """Compare the number of pairs without odometry with the number of pairs counted as dropped."""
    sent, missing = harness.pairs_since(first_ns)
    counted = harness.health[LOCALISATION].dropped - dropped
    row.observed.append(f"{sent} pairs sent, {sent - missing} localised, {counted} images counted as dropped")
    row.lost = f"{missing} pairs" if missing else "nothing"
    row.expect(counted >= missing, f"{missing} pairs are missing, {counted} drops were counted")


def malformed_input(kind: str, node: str, harness: Harness, row: Row) -> None:
    """Malformed messages: the node keeps running, does not grow, reports them, and processes the next valid message."""
    task, stamp_ns = TASK_OF_NODE.get(node, ""), harness.next_stamp()
    messages: Iterable[malformed.Malformed]
    if node == MONITOR:
        messages = malformed.for_monitor(stamp_ns)
    elif kind == "images":
        messages = malformed.images(task, harness.pair(task), harness.next_stamp)
    elif kind == "bytes":
        messages = malformed.broken_bytes(task, harness.pair(task), harness.rig)
    else:
        messages = [*malformed.camera_infos(task, stamp_ns, harness.rig), *malformed.poses_for(task, stamp_ns)]
    process, before_mb, problems = harness.nodes[node], harness.memory_mb(node), len(harness.problems)
    pid, said, count = process.popen.pid, len(process.text), 0
    for count, item in enumerate(messages, 1):
        harness.publish(*item)
        time.sleep(0.05 * (count % 10 == 0))
    begin = time.monotonic()
    if node == LOCALISATION:  # like a camera, so that the test does not wait for a pair lost in the burst
        with harness.driving(RATE_HZ):
            harness.wait_poses(2)
        harness.settle()
    elif node == MAPPING:
        harness.map()
    else:
        scored = harness.scored_poses
        harness.localise()
        harness.wait(lambda: harness.scored_poses > scored, "score of the pose")
    row.recovered(time.monotonic() - begin, harness.patience_s, "the next valid message")
    grown, reported = harness.memory_mb(node) - before_mb, len(harness.problems) - problems
    row.observed.append(f"{count} messages, {reported} problems reported")
    row.expect(process.is_running and process.popen.pid == pid, f"{node} has ended")
    row.expect(grown < GROWTH_MB, f"{node} has grown by {grown:.0f} MB")
    row.expect(reported or kind == "bytes", "no problem was reported on /diagnostics")
    row.expect("Traceback" not in process.text[said:], f"unexpected exception in {node}")


FAULTS: dict[str, Callable[[Harness, Row], None]] = {
    "kill-localisation": partial(kill, [LOCALISATION]),
    "kill-mapping": kill_mapping,
    "kill-monitor": partial(kill, [MONITOR]),
    "kill-all": partial(kill, NODES),
    **{f"stop-{node.removesuffix('_node')}": partial(stop, node) for node in NODES},
    **{
        f"{kind}-{node.removesuffix('_node')}": partial(malformed_input, kind, node)
        for node in (LOCALISATION, MAPPING)
        for kind in ("images", "bytes", "infos")
    },
    "messages-monitor": partial(malformed_input, "messages", MONITOR),
}


def inject(name: str, folder: Path, patience_s: float = 30.0) -> Row:
    """Start new nodes and inject one fault."""
    inject_fault = FAULTS[name]
    row = Row(name, str(getattr(inject_fault, "func", inject_fault).__doc__).splitlines()[0].strip())
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with Harness(folder, patience_s=patience_s) as harness:
            harness.wait_ready()
            inject_fault(harness, row)
            ended = [node for node, process in harness.nodes.items() if not process.is_running]
            row.expect(not ended, f"ended: {', '.join(ended)}")
    except SfrError as error:
        row.failures.append(str(error))
    row.verdict = "FAIL" if row.failures else "pass"
    return row


def inject_all(names: list[str], out: Path, scratch: Path) -> list[str]:
    """Inject faults, print each result and update the file; return the names of the failed faults."""
    out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for name in names:
        rows.append(inject(name, scratch / name))
        text = json.dumps({"schema": "sfr-faults/1", "rows": [*map(asdict, rows)]}, indent=1)
        (out / "faults.json").write_text(text)
        print(json.dumps(asdict(rows[-1])), flush=True)
    return [row.name for row in rows if row.verdict == "FAIL"]


def main(arguments: list[str]) -> int:
    """Inject faults sequentially; the observations are written to FOLDER/faults.json."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("names", nargs="*", help="names of faults; by default all")
    parser.add_argument("--out", type=Path, default=Path("out"), metavar="FOLDER")
    options = parser.parse_args(arguments)
    if unknown := sorted({*options.names} - FAULTS.keys()):
        parser.error(f"no fault '{unknown[0]}': known are {', '.join(FAULTS)}")
    return in_own_domain(lambda folder: inject_all(options.names or list(FAULTS), options.out, folder))
