"""Bursts, and clocks and stamps that jump."""

from __future__ import annotations

import time

from rosgraph_msgs.msg import Clock

from sfr_loc_map.fault_injection.harness import LOCALISATION, MAPPING, MONITOR, Bench
from sfr_loc_map.fault_injection.outcome import Fault, Outcome
from sfr_loc_map.nodes.messages.fields import time_msg

BURST_HZ, BURST_S = 100.0, 2.0
HOUR_NS = 3_600_000_000_000
SIMULATED = ("-p", "use_sim_time:=true")


def burst(bench: Bench, outcome: Outcome) -> None:
    """Publish pairs ten times as fast as usual."""
    dropped, first = _dropped(bench), bench.next_stamp()
    with bench.driving(BURST_HZ):
        time.sleep(BURST_S)
    last = max(bench.sent)
    outcome.recover_s = bench.until(lambda: last in bench.odometry, "odometry of the last pair")
    time.sleep(0.5)
    sent = [stamp for stamp in bench.sent if stamp > first]
    missing = sum(stamp not in bench.odometry for stamp in sent)
    counted = _dropped(bench) - dropped
    outcome.observed.append(f"{len(sent)} pairs sent, {len(sent) - missing} localised, {counted} counted as dropped")
    outcome.lost = f"{missing} pairs" if missing else "nothing"
    outcome.expect(counted >= missing, f"{missing} pairs are missing, {counted} drops were counted")
    bench.localise(2)


def stamps_jump(bench: Bench, outcome: Outcome) -> None:
    """Let the stamps jump a day ahead and back, as a bag that loops or a camera whose clock is set does."""
    now = bench.next_stamp()
    for name, shift_ns in (("ahead", 24 * HOUR_NS), ("back", 0), ("back before all", -24 * HOUR_NS), ("now", 0)):
        bench.start_at_truth()
        for number in range(3):
            stamp = bench.next_stamp() if name == "now" else now + shift_ns + number * 100_000_000
            bench.odometry.pop(stamp, None)
            bench.send_loc(stamp)
            bench.await_pose(stamp, f"odometry after the jump {name}")
    text = bench.nodes[LOCALISATION].text
    begun = text.count("stamps have gone back")
    outcome.observed.append(f"every pair was localised; {begun} new runs begun and told of")
    outcome.lost = "nothing; the score of a run ends with it"
    outcome.expect(begun >= 2, f"{begun} of 2 jumps back were told of")


def clock_jumps(bench: Bench, outcome: Outcome) -> None:
    """Let the simulated clock stand still, jump an hour ahead and two hours back."""
    clock = bench.publisher(Clock, "/clock")
    bench.until(lambda: clock.get_subscription_count() >= 3, "listeners on /clock")
    base = 1_700_000_000_000_000_000
    for shift_ns in (0, HOUR_NS, -HOUR_NS):
        now_ns = base + shift_ns
        clock.publish(Clock(clock=time_msg(now_ns)))
        time.sleep(0.3)
        bench.send_infos("loc")
        for number in range(1, 4):
            stamp = now_ns + number * 100_000_000
            clock.publish(Clock(clock=time_msg(stamp)))
            bench.send_loc(stamp)
            bench.await_pose(stamp, f"odometry after {shift_ns / HOUR_NS:+.0f} h")
    outcome.observed.append(
        "every pair was localised after the clock had gone on, ahead and back; health came all the time"
    )
    outcome.lost = "nothing; localisation starts anew when the clock goes back"


def _dropped(bench: Bench) -> int:
    values = bench.health[LOCALISATION][3]
    return sum(int(value) for name, value in values.items() if name.startswith("dropped_"))


FAULTS = (
    Fault(
        "burst",
        f"pairs at {BURST_HZ:g} Hz, ten times the usual, for {BURST_S:g} s",
        "every pair is localised or counted as dropped; the last one comes out",
        burst,
    ),
    Fault(
        "stamps-jump",
        "stamps jump a day ahead, back, a day before, and to now",
        "a new run begins when they go back, and is told of; every pair is localised",
        stamps_jump,
    ),
    Fault(
        "clock-jumps",
        "the simulated clock stands, jumps an hour ahead, two hours back (use_sim_time)",
        "every pair is localised; health goes on by a clock that does not jump",
        clock_jumps,
        {LOCALISATION: SIMULATED, MAPPING: SIMULATED, MONITOR: SIMULATED},
    ),
)
