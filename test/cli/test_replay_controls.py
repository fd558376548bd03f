"""`sfr replay` under an operator's hand: services and parameters, with the nodes over DDS."""

# ruff: noqa: E402 - ROS may be absent
from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "nodes"))

import rclpy
from made_scene import PERIOD_NS, START_NS, write_folder
from nav_msgs.msg import Odometry
from processes import Peer, Process
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from std_srvs.srv import SetBool

from sfr_loc_map.inputs import stamp_of

COMMAND = ("-c", "from sfr_loc_map.cli.main import main; raise SystemExit(main())")


@pytest.fixture
def peer(own_domain: None) -> Iterator[Peer]:
    rclpy.init(args=[])
    with Peer() as found:
        yield found
    rclpy.try_shutdown()


def set_parameter(peer: Peer, name: str, value: float) -> tuple[bool, str]:
    client = peer.node.create_client(SetParameters, "/sfr_player/set_parameters")
    peer.until(client.service_is_ready, "the player's parameters")
    given = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    future = client.call_async(SetParameters.Request(parameters=[Parameter(name=name, value=given)]))
    peer.until(future.done, "the answer")
    (result,) = future.result().results
    return result.successful, result.reason


def indices(odometry: list[Odometry]) -> list[int]:
    return [round((stamp_of(message) - START_NS) / PERIOD_NS) for message in odometry]


@pytest.mark.slow
def test_paused_step_resume_rate_seek_loop_and_interruption(tmp_path: Path, peer: Peer) -> None:
    source, out = write_folder(tmp_path / "source", 20, 0), tmp_path / "out"
    odometry = peer.listen(Odometry, "localisation/odometry")
    options = ["--rate", "1", "--start-paused", "--start", "truth", "--out", str(out)]
    with Process(tmp_path / "log", *COMMAND, "replay", str(source), *options) as replay:
        peer.watch(replay)
        answer = peer.call("/sfr_player/is_paused")
        assert answer.success
        peer.until(lambda: peer.call("/sfr_player/is_paused").message == "paused at 0.000 s", "the first place")
        peer.wait_until_known_to("localisation_node")
        for count in (1, 2):
            assert peer.call("/sfr_player/play_next").success
            peer.until(lambda count=count: len(odometry) == count, "the next pair")
        peer.spin(0.5)
        assert indices(odometry) == [0, 1]
        assert set_parameter(peer, "rate", -1.0) == (False, "a number of 0.0 or more is needed")
        assert set_parameter(peer, "rate", 0.4)[0]  # slow enough to be paused on a busy host before the drive ends
        assert peer.call("/sfr_player/resume").message.startswith("playing")
        peer.until(lambda: len(odometry) >= 6, "pairs")
        assert peer.call("/sfr_player/pause").success
        count = -1
        while count != len(odometry):  # on a busy host results of pairs played before are still on their way
            count = len(odometry)
            peer.spin(0.5)
        assert indices(odometry) == list(range(count))
        assert set_parameter(peer, "seek_s", 60.0) == (False, "the last pair is at 1.900 s: nothing is left after it")
        assert set_parameter(peer, "seek_s", 0.5)[0]
        peer.spin(1.0)
        assert len(odometry) == count
        client = peer.node.create_client(SetBool, "/sfr_player/set_loop")
        peer.until(client.service_is_ready, "the service")
        future = client.call_async(SetBool.Request(data=True))
        peer.until(future.done, "the answer")
        peer.call("/sfr_player/toggle_paused")
        peer.until(lambda: 0 in indices(odometry[count:]), "the loop")
        after = indices(odometry[count:])
        assert after == [*range(5, 20), 0]
        first, again = odometry[0].pose.pose.position, odometry[count + 15].pose.pose.position
        assert (first.x, first.y, first.z) == (again.x, again.y, again.z)
        peer.call("/sfr_player/pause")
        os.kill(replay.popen.pid, signal.SIGINT)
        peer.until(lambda: replay.popen.poll() is not None, "the end", 60.0)
        assert replay.popen.returncode == 130, replay.text
        assert "sfr: interrupted: 15 of 20 pairs were played, and scored" in replay.text
        assert replay.text.count("plays again from") == 2
    score = json.loads((out / "report.json").read_text())
    assert len((out / "estimate.csv").read_text().splitlines()) == 1 + 15
    assert score["trajectory"]["estimate_poses"] == 15  # of the whole run from 0.5 s on, not of the one under way
    assert score["trajectory"]["lost"] == 0
    assert score["incomplete"].startswith("the estimate covers 75 % of the images")
    # what the jump and the interruption cut short is kept
    assert [len((out / name / "estimate.csv").read_text().splitlines()) - 1 for name in ("run_1", "run_2")] == [
        count,
        len(odometry) - count - 15,
    ]
    assert replay.text.count("was cut short and is not scored") == 2
