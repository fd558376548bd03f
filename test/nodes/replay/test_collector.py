"""Which run of a replay is scored."""

from types import SimpleNamespace

import numpy as np
import pytest

from sfr_loc_map.nodes.replay.collector import ResultCollector


@pytest.mark.parametrize(
    ("runs", "scored"),
    [
        ([(3, True)], 0),
        ([(3, True), (0, False)], 0),
        ([(3, True), (9, False)], 0),
        ([(3, True), (2, True)], 1),
        ([(3, False), (0, False)], 0),
        ([(3, False), (1, False)], 1),
        ([(3, True), (0, False), (0, False)], 0),
        ([(3, False), (2, True), (9, False)], 1),
        ([(0, False)], 0),
    ],
)
def test_the_last_whole_run_is_scored_else_the_last_with_a_result(runs: list[tuple[int, bool]], scored: int) -> None:
    """Runs are of so many poses, each played to its end or not; the last one is under way."""
    graph = SimpleNamespace(create_subscription=lambda *_: None)
    collector, made = ResultCollector(SimpleNamespace(node=graph, spin_for=lambda _: None)), []
    for number, (count, whole) in enumerate(runs):
        if number:
            collector.begin_run()
        collector.results.rows += [(stamp_ns, (0.0,), (0.0,)) for stamp_ns in range(count)]
        collector.results.covariances |= {stamp_ns: np.eye(6) for stamp_ns in range(count)}
        collector.results.report = '{"trajectory": {"estimate_poses": 9}}'
        collector.results.whole = whole
        made.append(collector.results)
    assert collector.finish(0, has_map_truth=False) is made[scored]
