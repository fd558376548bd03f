"""A replay fails with what one of its nodes reports, and ignores what other nodes report."""

import time
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.message_types import Level, StatusKind
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.replay import waiting
from sfr_loc_map.replay.collector import ResultCollector
from sfr_loc_map.replay.message_store import Received, ReceivedCloud
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.replay.waiting import AwaitedNode, OurMapper, OurNode, ResultWaits
from sfr_loc_map.ros.statuses import status_msg
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import DIAGNOSTICS, call_topic


def add_call(received: Received, state: MappingState) -> None:
    """Add a call of the mapper for the pair with the stamp 1."""
    received.maps.add_call(CallRecord(1, 0.1, state))


def add_map(received: Received) -> None:
    """Add a complete map: its call and its cloud."""
    add_call(received, MappingState.MAPPED_SET)
    cloud = PointCloud.from_structured(np.zeros(2, PointCloud.dtype()))
    received.maps.add_cloud(ReceivedCloud(1, cloud.xyz, cloud))


def waits_of(peer: ReplayPeer, received: Received, *, pairs_per_map: int = 3, is_lock_step: bool) -> ResultWaits:
    """Return the waits for the results of the suite's nodes."""
    collector = ResultCollector(peer, received)
    nodes: dict[Task, AwaitedNode] = {
        Task.LOCALISATION: OurNode(Task.LOCALISATION, collector),
        Task.MAPPING: OurMapper(Task.MAPPING, collector, pairs_per_map),
    }
    return ResultWaits(collector, nodes, is_lock_step)


def publish(waits: ResultWaits, task: Task, stamp_ns: int) -> None:
    """Act as the session after the last image of a pair."""
    waits.collector.received.add_pair(task, stamp_ns)
    waits.after_pair(task, stamp_ns, 0.0)


@pytest.mark.parametrize(("kind", "error"), [(StatusKind.INPUT, InputError), (StatusKind.FAULT, NodeError)])
def test_an_unusable_input_and_an_internal_fault_are_different_errors(kind: StatusKind, error: type[Exception]) -> None:
    supervisor = SimpleNamespace(processes={"localisation_node": None}, check=lambda: None)
    with ReplayPeer(supervisor) as peer:
        waits = waits_of(peer, Received(), is_lock_step=True)
        publisher = peer.ros_node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        for name in ("another_node", "localisation_node"):
            status = status_msg(f"{name}: {kind}", Level.ERROR, f"{name} has failed", {})
            publisher.publish(DiagnosticArray(status=[status]))
        with pytest.raises(error, match=r"^localisation_node: localisation_node has failed$"):
            publish(waits, Task.LOCALISATION, 1)


def test_a_replay_at_a_rate_fails_with_an_internal_fault_and_continues_after_an_unusable_input() -> None:
    supervisor = SimpleNamespace(processes={"mapping_node": None}, check=lambda: None)
    with ReplayPeer(supervisor) as peer:
        waits = waits_of(peer, Received(), is_lock_step=False)
        publisher = peer.ros_node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        for kind in (StatusKind.INPUT, StatusKind.FAULT):
            publish(waits, Task.LOCALISATION, 1)
            status = status_msg(f"mapping_node: {kind}", Level.ERROR, "a stage has failed", {})
            publisher.publish(DiagnosticArray(status=[status]))
            peer.spin_for(0.2)
        for action in (lambda: publish(waits, Task.LOCALISATION, 2), waits.finish):
            with pytest.raises(NodeError, match=r"^mapping_node: a stage has failed$"):
                action()


def test_a_lost_pair_does_not_fail_the_map_of_a_shortened_replay(monkeypatch: pytest.MonkeyPatch) -> None:
    """The map in progress is finished without the pair, of which nothing arrives."""
    monkeypatch.setattr(waiting, "QUIET_S", 0.3)
    supervisor = SimpleNamespace(processes={}, check=lambda: None)
    received = Received()

    def finish(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        add_map(received)
        response.success = True
        return response

    with ReplayPeer(supervisor) as peer:
        peer.ros_node.create_service(Trigger, "mapping_node/finish", finish)
        waits = waits_of(peer, received, is_lock_step=False)
        for stamp_ns in (1, 2):
            publish(waits, Task.MAPPING, stamp_ns)
        add_call(received, MappingState.MAPPED)
        waits.finish()
    assert (received.maps.mapped_ns, received.maps.map_count) == ([1], 1)


@pytest.mark.parametrize("is_lock_step", [True, False])
def test_a_fusion_that_takes_longer_than_the_quiet_time_keeps_its_map(
    monkeypatch: pytest.MonkeyPatch, is_lock_step: bool
) -> None:
    """The mapper answers after the fusion, although no map is in progress then."""
    monkeypatch.setattr(waiting, "QUIET_S", 0.2)
    supervisor = SimpleNamespace(processes={}, check=lambda: None)
    received = Received()

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        time.sleep(0.6)
        add_map(received)
        response.message = "a map is fused from 1 to 3 pairs: got 0"
        return response

    with ReplayPeer(supervisor) as peer:
        peer.ros_node.create_service(Trigger, "mapping_node/finish", answer)
        waits = waits_of(peer, received, pairs_per_map=1, is_lock_step=is_lock_step)
        add_call(received, MappingState.MAPPED)
        received.maps.sent_ns.add(1)
        waits.finish()
    assert received.maps.map_count == 1


def test_an_external_node_has_its_timeout_for_the_last_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """The answer takes longer than the quiet time of a replay."""
    monkeypatch.setattr(waiting, "QUIET_S", 0.1)
    received = Received.without_messages(Task.MAPPING)
    received.maps.sent_ns.add(1)
    with ReplayPeer(SimpleNamespace(processes={}, check=lambda: None)) as peer:
        answered_s = time.monotonic() + 0.6

        def is_settled(_: int) -> bool:
            return time.monotonic() >= answered_s

        settling = {"is_settled": is_settled, "check": lambda: None, "finish": lambda: None}
        external = cast("Any", SimpleNamespace(quiet_s=30.0, **settling))
        ResultWaits(ResultCollector(peer, received), {Task.MAPPING: external}, False).finish()
        assert is_settled(1)


def test_an_invalid_call_of_an_external_node_is_counted() -> None:
    received = Received.without_messages(Task.MAPPING)
    with ReplayPeer(SimpleNamespace(processes={}, check=lambda: None)) as peer:
        collector = ResultCollector(peer, received)
        publisher = peer.ros_node.create_publisher(String, call_topic(Task.MAPPING), 10)
        for text in ("{}", "[]"):
            publisher.publish(String(data=text))
        assert peer.spin(10.0, lambda: received.refused_calls == 2)
        assert collector is not None
    assert "stamp_ns" in received.result(None).first_refusal


def test_a_map_of_remaining_pairs_that_cannot_be_finished_fails_the_replay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "QUIET_S", 0.2)
    supervisor = SimpleNamespace(processes={}, check=lambda: None)
    received = Received()

    def refuse(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = "the pairs are of other cameras"
        return response

    with ReplayPeer(supervisor) as peer:
        peer.ros_node.create_service(Trigger, "mapping_node/finish", refuse)
        waits = waits_of(peer, received, is_lock_step=True)
        add_call(received, MappingState.MAPPED)
        received.maps.sent_ns.add(1)
        with pytest.raises(NodeError, match=r"^mapping_node did not finish its map: the pairs are of other cameras$"):
            waits.finish()
