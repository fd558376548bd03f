"""Processor time per pair and memory of the monitor as a function of the length of a run.

python -m campaigns long-monitor [--pairs 36000] [--hz 10] [--steps 12]

Poses, ground truth and calls of a synthetic drive are added to the monitor's score as by the node's worker, in one
process and without DDS. The figures therefore exclude decoding and transport of messages. At `--steps` lengths the
score is computed and serialised as for publication. The node rests nine times the processor time of a score between two
scores. The campaign applies this rule to the measured times instead of waiting.

The exit code is 1 if the processor time per pair or the memory exceeds its bound.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.nodes.monitor.score_publisher import RESTS, score_statuses
from sfr_loc_map.scoring.live.live_score import LiveRun
from sfr_loc_map.scoring.live.monitor_score import MonitorScore

PUBLISH_PERIOD_S = 1.0  #: The node's default.
MAX_SHARE = 1.0 / (1.0 + RESTS)  #: Largest fraction of one core for scoring.
MAX_RECEIVE_S = 1e-3  #: Largest processor time for the messages of one pair.
MAX_BYTES_PER_PAIR = 4096  #: Largest growth of resident memory per pair.
LIMITS = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.2}]}
LOOP_M, STEP_M, SIGMA_M = 200.0, 0.05, 1e-4


class Step(NamedTuple):
    """Measurements after a number of pairs."""

    pairs: int
    receive_s: float  #: Processor time per pair since the previous step.
    score_s: float  #: Processor time of one score, including serialisation.
    resident_bytes: int


def resident_bytes() -> int:
    """Return the resident memory of this process."""
    with open("/proc/self/statm", encoding="ascii") as stream:
        return int(stream.read().split()[1]) * 4096


def measured(pairs: int, hz: float, steps: int) -> Iterator[Step]:
    """Add a synthetic drive to the monitor's score; yield the measurements at `steps` lengths."""
    rng = np.random.default_rng(1)
    score = MonitorScore(ScoreConfig(), parse_limits(LIMITS, "campaign"))
    period_ns = round(1e9 / hz)
    covariance, step = np.diag([1e-4] * 6), np.full(48, 1e-8)
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
                CallRecord(
                    stamp_ns,
                    0.05,
                    "tracking",
                    peak_rss_bytes=200_000_000,
                    above_idle_bytes=100_000_000,
                    statistics={"stage_align_s": 0.02},
                    step=step,
                )
            )
        received_s = time.process_time()
        result = score.result(LiveRun(details=False))
        to_json(result)
        score_statuses(result)
        yield Step(
            length, (received_s - begin_s) / (length - first), time.process_time() - received_s, resident_bytes()
        )
        first = length


def scoring_per_pair_s(steps: list[Step], hz: float) -> float:
    """Return the processor time of scoring per pair by the node's rule, interpolated between the steps."""
    pairs = np.array([0.0, *(step.pairs for step in steps)])
    costs = np.array([steps[0].score_s, *(step.score_s for step in steps)])
    end_s, now_s, used_s = steps[-1].pairs / hz, 0.0, 0.0
    while now_s < end_s:
        cost_s = float(np.interp(now_s * hz, pairs, costs))
        used_s += cost_s
        now_s += max(PUBLISH_PERIOD_S, 1.0 / hz, (1.0 + RESTS) * cost_s)
    return used_s / (now_s * hz)  # the rest after the last score ends later than the run


def main(arguments: list[str]) -> int:
    """Print the measurements; return 1 if a bound is exceeded."""
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
