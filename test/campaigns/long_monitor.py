"""What a long run costs the monitor: processor time for each pair, and memory, against the length of the run.

python -m campaigns long-monitor [--pairs 36000] [--hz 10] [--steps 12]

Poses, their ground truth and calls of a made drive go into the monitor's score as the node's worker gives them, in one
process and without DDS: decoding of messages and transport are not in the figures. At so many lengths the score is
computed and written as the node publishes it. How often the node scores at a rate of pairs follows from these times
and from its own rule (a rest of nine times the processor time of a score): the campaign applies the rule to the
measured times, and does not wait.

Exit code 1 if the processor time for each pair or the memory is beyond its bound.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.nodes.score_messages import score_statuses
from sfr_loc_map.nodes.score_publisher import RESTS
from sfr_loc_map.runs.calls import CallRecord
from sfr_loc_map.scoring.monitor_score import MonitorScore

PUBLISH_PERIOD_S = 1.0  #: Default of the node.
MAX_SHARE = 1.0 / (1.0 + RESTS)  #: Largest fraction of one core that scoring takes.
MAX_RECEIVE_S = 1e-3  #: Largest processor time for what comes with one pair.
MAX_BYTES_PER_PAIR = 4096  #: Largest growth of resident memory.
LIMITS = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.2}]}
LOOP_M, STEP_M, SIGMA_M = 200.0, 0.05, 1e-4


class Step(NamedTuple):
    """What was measured when so many pairs had come."""

    pairs: int
    receive_s: float  #: Processor time for each pair since the step before.
    score_s: float  #: Processor time of one score, as it is published.
    resident_bytes: int


def resident_bytes() -> int:
    """Return the resident memory of this process."""
    with open("/proc/self/statm", encoding="ascii") as stream:
        return int(stream.read().split()[1]) * 4096


def measured(pairs: int, hz: float, steps: int) -> Iterator[Step]:
    """Give a made drive to the score of the monitor; yield what it costs at so many lengths."""
    rng = np.random.default_rng(1)
    score = MonitorScore(ScoreConfig(), parse_limits(LIMITS, "campaign"))
    period_ns = round(1e9 / hz)
    covariance, step = np.diag([1e-4] * 6), tuple(np.full(48, 1e-8).tolist())
    lengths = np.unique(np.linspace(0, pairs, steps + 1).astype(int)[1:])
    drift, first = np.zeros(3), 0
    for length in lengths.tolist():
        begin_s = time.process_time()
        for number in range(first, length):
            angle = number * STEP_M / (LOOP_M / (2.0 * np.pi))
            true = np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0]) * LOOP_M / (2.0 * np.pi)
            quat = [0.0, 0.0, float(np.sin(0.5 * angle)), float(np.cos(0.5 * angle))]
            drift += rng.normal(0.0, SIGMA_M, 3)
            stamp_ns = number * period_ns
            score.add_truth(stamp_ns, true.tolist(), quat)
            score.add_estimate(stamp_ns, (true + drift).tolist(), quat, covariance)
            score.add_call(
                CallRecord(stamp_ns, 0.05, "tracking", 200_000_000, 100_000_000, {"stage_align_s": 0.02}, step)
            )
        received_s = time.process_time()
        result = score.result(details=False)
        to_json(result)
        score_statuses(result)
        yield Step(
            length, (received_s - begin_s) / (length - first), time.process_time() - received_s, resident_bytes()
        )
        first = length


def scoring_per_pair_s(steps: list[Step], hz: float) -> float:
    """Return the processor time of scoring for each pair that the node's rule gives, with times between the steps."""
    pairs = np.array([0.0, *(step.pairs for step in steps)])
    costs = np.array([steps[0].score_s, *(step.score_s for step in steps)])
    end_s, now_s, used_s = steps[-1].pairs / hz, 0.0, 0.0
    while now_s < end_s:
        cost_s = float(np.interp(now_s * hz, pairs, costs))
        used_s += cost_s
        now_s += max(PUBLISH_PERIOD_S, 1.0 / hz, (1.0 + RESTS) * cost_s)
    return used_s / steps[-1].pairs


def main(arguments: list[str]) -> int:
    """Print what each length costs; return 1 if a bound is exceeded."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=36_000)
    parser.add_argument("--hz", type=float, default=10.0, help="rate of pairs")
    parser.add_argument("--steps", type=int, default=12)
    options = parser.parse_args(arguments)
    steps = []
    print("pairs   receive, ms/pair   score, ms   resident, MiB")
    for step in measured(options.pairs, options.hz, options.steps):
        steps.append(step)
        columns = (1e3 * step.receive_s, 1e3 * step.score_s, step.resident_bytes / 2**20)
        print("{:5d}   {:16.3f}   {:9.1f}   {:13.1f}".format(step.pairs, *columns), flush=True)
    scoring_s = scoring_per_pair_s(steps, options.hz)
    grown = (steps[-1].resident_bytes - steps[0].resident_bytes) / max(steps[-1].pairs - steps[0].pairs, 1)
    print(
        f"scoring at {options.hz:g} Hz: {1e3 * scoring_s:.2f} ms of processor time per pair, "
        f"{100.0 * scoring_s * options.hz:.2f} % of one core; memory grows by {grown:.0f} bytes per pair"
    )
    is_bounded = (
        scoring_s * options.hz <= MAX_SHARE
        and max(step.receive_s for step in steps) <= MAX_RECEIVE_S
        and grown <= MAX_BYTES_PER_PAIR
    )
    print("bounded" if is_bounded else "BEYOND A BOUND")
    return 0 if is_bounded else 1
