"""Which run of a replay is scored, and how a signal ends it."""

from __future__ import annotations

import os
import signal
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from sfr_loc_map.nodes.processes import first_signal_stops, sigterm_as_interrupt
from sfr_loc_map.nodes.replay.collector import ResultCollector
from sfr_loc_map.nodes.replay.results import ReplayResults


def collector_of(*runs: tuple[int, bool]) -> ResultCollector:
    """Collect runs of so many poses, each played to its end or not; the last one is under way."""
    graph = SimpleNamespace(create_subscription=lambda *_: None)
    collector = ResultCollector(SimpleNamespace(node=graph))  # type: ignore[arg-type]
    for number, (count, whole) in enumerate(runs):
        if number:
            collector.begin_run()
        collector.results.rows += [(stamp_ns, (0.0,), (0.0,)) for stamp_ns in range(count)]
        collector.results.covariances |= {stamp_ns: np.eye(6) for stamp_ns in range(count)}
        collector.results.whole = whole
    return collector


@pytest.mark.parametrize(
    ("runs", "scored"),
    [
        ([(3, True)], 3),
        ([(3, True), (0, False)], 3),
        ([(3, True), (9, False)], 3),
        ([(3, True), (2, True)], 2),
        ([(3, False), (0, False)], 3),
        ([(3, False), (1, False)], 1),
        ([(3, True), (0, False), (0, False)], 3),
        ([(3, False), (2, True), (9, False)], 2),
        ([(0, False)], 0),
    ],
)
def test_the_last_whole_run_is_scored_else_the_last_with_a_result(runs: list[tuple[int, bool]], scored: int) -> None:
    collector = collector_of(*runs)
    expected = collector._to_be_scored()
    assert len(expected.rows) == scored
    if expected is not collector.results:
        assert collector.finish(0, has_map_truth=False) is expected  # there is nothing to wait for


def test_results_of_a_run_are_not_those_of_the_next() -> None:
    collector = collector_of((3, True), (1, False))
    assert len(collector.results.rows) == 1
    assert isinstance(collector._to_be_scored(), ReplayResults)
    assert collector._to_be_scored() is not collector.results


def test_the_first_signal_stops_in_good_order_and_the_second_at_once() -> None:
    stopped: list[bool] = []

    def run() -> None:
        with sigterm_as_interrupt(), first_signal_stops(lambda: stopped.append(True)) as received:
            assert not received()
            os.kill(os.getpid(), signal.SIGTERM)
            assert received()
            assert stopped == [True]
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run()
    assert stopped == [True]
    before = signal.getsignal(signal.SIGINT)
    with first_signal_stops(lambda: None):
        pass
    assert signal.getsignal(signal.SIGINT) is before
