"""Injected faults of time: bursts, jumps of clocks and stamps."""

from __future__ import annotations

import time

from rosgraph_msgs.msg import Clock

from sfr_loc_map.fault_injection.fault import Fault, Outcome
from sfr_loc_map.fault_injection.harness import LOCALISATION, MAPPING, MONITOR, Harness
from sfr_loc_map.nodes.messages.fields import time_msg

BURST_HZ, BURST_S = 100.0, 2.0
HOUR_NS = 3_600_000_000_000
SIMULATED = ("-p", "use_sim_time:=true")


def burst(harness: Harness, outcome: Outcome) -> None:
    """Publish pairs at ten times the nominal rate."""
    dropped, first = harness.received.dropped(LOCALISATION), harness.rover.next_stamp()
    with harness.rover.driving(BURST_HZ):
        time.sleep(BURST_S)
    last = max(harness.rover.sent)
    outcome.recover_s = harness.wait_until(lambda: last in harness.received.odometry, "odometry of the last pair")
    time.sleep(0.5)
    pairs = harness.pairs_since(first)
    counted = harness.received.dropped(LOCALISATION) - dropped
    outcome.observed.append(f"{pairs}, {counted} counted as dropped")
    outcome.lost = pairs.lost
    outcome.expect(counted >= pairs.missing, f"{pairs.missing} pairs are missing, {counted} drops were counted")
    harness.localise(2)


def stamps_jump(harness: Harness, outcome: Outcome) -> None:
    """Let the stamps jump a day ahead and back, as those of a looping bag or of a camera whose clock is set."""
    now = harness.rover.next_stamp()
    for name, shift_ns in (("ahead", 24 * HOUR_NS), ("back", 0), ("back before all", -24 * HOUR_NS), ("now", 0)):
        harness.rover.start_at_truth()
        for number in range(3):
            stamp = harness.rover.next_stamp() if name == "now" else now + shift_ns + number * 100_000_000
            harness.received.odometry.pop(stamp, None)
            harness.rover.send_loc(stamp)
            harness.wait_pose(stamp, f"odometry after the jump {name}")
    text = harness.nodes[LOCALISATION].text
    resets = text.count("stamps have gone back")
    outcome.observed.append(f"every pair was localised; {resets} resets reported")
    outcome.lost = "nothing; the score starts again"
    outcome.expect(resets >= 2, f"{resets} of 2 jumps back were reported")


def clock_jumps(harness: Harness, outcome: Outcome) -> None:
    """Let the simulated clock stop, jump an hour ahead and two hours back."""
    clock = harness.rover.publisher(Clock, "/clock")
    harness.wait_until(lambda: clock.get_subscription_count() >= 3, "subscribers of /clock")
    base = 1_700_000_000_000_000_000
    for shift_ns in (0, HOUR_NS, -HOUR_NS):
        now_ns = base + shift_ns
        clock.publish(Clock(clock=time_msg(now_ns)))
        time.sleep(0.3)
        harness.rover.send_camera_info("loc")
        for number in range(1, 4):
            stamp = now_ns + number * 100_000_000
            clock.publish(Clock(clock=time_msg(stamp)))
            harness.rover.send_loc(stamp)
            harness.wait_pose(stamp, f"odometry after {shift_ns / HOUR_NS:+.0f} h")
    outcome.observed.append(
        "every pair was localised after the clock had jumped ahead and back; health was published throughout"
    )
    outcome.lost = "nothing; localisation restarts when the clock goes back"


FAULTS = (
    Fault(
        "burst",
        f"pairs at {BURST_HZ:g} Hz, ten times the nominal rate, for {BURST_S:g} s",
        "every pair is localised or counted as dropped; the last one is localised",
        burst,
    ),
    Fault(
        "stamps-jump",
        "stamps jump a day ahead, back, a day before, and to now",
        "localisation resets when they go back, and reports it; every pair is localised",
        stamps_jump,
    ),
    Fault(
        "clock-jumps",
        "the simulated clock stops, jumps an hour ahead, two hours back (use_sim_time)",
        "every pair is localised; health continues by a monotonic clock",
        clock_jumps,
        {LOCALISATION: SIMULATED, MAPPING: SIMULATED, MONITOR: SIMULATED},
    ),
)
