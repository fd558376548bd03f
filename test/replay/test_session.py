"""The monitor is asked for its figures until the figures contain all results of a replay."""

from functools import partial
from types import SimpleNamespace

import pytest
from std_msgs.msg import String
from std_srvs.srv import Trigger

from helpers import made_scores
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.metrics.config import MappingState, ScoreConfig
from sfr_loc_map.metrics.errors.cloud_error import score_map
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.replay import session
from sfr_loc_map.replay.received import ReceivedResults
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.ros.qos import LATCHED
from sfr_loc_map.scoring.live.live_score import LiveRun
from sfr_loc_map.scoring.live.monitor_score import MonitorScore
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import REPORT

CALLS = (
    CallRecord(1, 0.1, "tracking"),
    CallRecord(2, 0.1, "tracking"),
    CallRecord(3, float("nan"), "tracking"),  # without a time, a call has no figure
    CallRecord(2, 0.1, MappingState.MAPPED, task=Task.MAPPING),
    CallRecord(2, 0.3, MappingState.MAPPED_SET, task=Task.MAPPING),
)


@pytest.mark.parametrize("missing", [0, 1, 2, 3, 5])
def test_the_figures_are_requested_again_until_they_contain_the_last_result(
    monkeypatch: pytest.MonkeyPatch, missing: int
) -> None:
    """The monitor receives one more result before each request, last the map; its first figures lack the last ones."""
    monkeypatch.setattr(session, "FIGURE_REQUESTS", 4)
    results, score = ReceivedResults(has_map_truth=True), MonitorScore(ScoreConfig(), None)
    cloud, truths = made_scores.cloud(32, 1)
    results.add_cloud(2, cloud)
    for call in CALLS:
        results.add_call(call.task, call)

    def add_map() -> None:
        score.maps.add(score_map(cloud, truths, ScoreConfig().map))

    arrivals = [*(partial(score.add_call, call) for call in CALLS), add_map]
    late = arrivals[len(arrivals) - missing :]
    for arrive in arrivals[: len(arrivals) - missing]:
        arrive()
    requests = list[Trigger.Request]()

    def finish(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        requests.append(request)
        publisher.publish(String(data=to_json(score.result(LiveRun(details=False)))))
        if late:
            late.pop(0)()
        response.success = True
        return response

    with ReplayPeer(SimpleNamespace(processes={}, check=lambda: None)) as peer:
        publisher = peer.ros_node.create_publisher(String, REPORT, LATCHED)
        peer.ros_node.create_service(Trigger, "monitor_node/finish", finish)
        assert session.publish_final_figures(peer, results) == (missing < 4)
    assert len(requests) == min(missing + 1, 4)
