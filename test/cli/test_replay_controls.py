"""`sfr replay` is paused, resumed, interrupted and limited to a part of a source, with the nodes over DDS."""

# ruff: noqa: E402 - ROS may be absent
from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]

import rclpy
from nav_msgs.msg import Odometry

from helpers.cli_result import Sfr
from helpers.made_scene import PERIOD_NS, START_NS, write_folder
from helpers.peer import Peer
from helpers.processes import Process, abandoned, nodes_of, segments_of
from sfr_loc_map.message_stamps import stamp_of

COMMAND = ("-m", "sfr_loc_map")


@pytest.fixture
def peer(own_domain: None) -> Iterator[Peer]:
    rclpy.init(args=[])
    with Peer() as found:
        yield found
    rclpy.try_shutdown()


def indices(odometry: list[Odometry]) -> list[int]:
    return [round((stamp_of(message) - START_NS) / PERIOD_NS) for message in odometry]


@pytest.mark.slow
def test_pause_resume_and_interruption(tmp_path: Path, peer: Peer) -> None:
    source, out = write_folder(tmp_path / "source", 20, 0), tmp_path / "out"
    odometry = peer.listen(Odometry, "localisation/odometry")
    options = ["--rate", "0.4", "--start-paused", "--start", "truth", "--out", str(out)]
    with Process(tmp_path / "log", *COMMAND, "replay", str(source), *options) as replay:
        peer.watch(replay)
        assert peer.call("/sfr_player/pause").message == "paused"
        peer.wait_until_known_to("localisation_node")
        peer.spin(0.5)
        assert not odometry
        assert peer.call("/sfr_player/resume").message == "playing"
        peer.until(lambda: len(odometry) >= 4, "pairs")
        assert peer.call("/sfr_player/pause").success
        count = -1
        while count != len(odometry):  # on a busy host results of pairs played before are still on their way
            count = len(odometry)
            peer.spin(0.5)
        assert indices(odometry) == list(range(count))
        pids = nodes_of(replay.popen.pid)
        shared = segments_of([*pids, replay.popen.pid])
        os.kill(replay.popen.pid, signal.SIGINT)
        peer.until(lambda: replay.popen.poll() is not None, "the end", 60.0)
        assert replay.popen.returncode == 130, replay.text
        assert f"sfr: interrupted: {count} of 20 pairs were played and scored" in replay.text
        assert "Traceback" not in replay.text
    assert len(pids) == 3
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids), "no node is left behind"
    assert shared
    assert not abandoned(shared)
    score = json.loads((out / "report.json").read_text())
    assert len((out / "estimate.csv").read_text().splitlines()) == 1 + count
    assert score["incomplete"].startswith(f"the estimate covers {100 * count // 20} % of the images")


@pytest.mark.slow
def test_a_part_of_a_source_is_played(sfr: Sfr, tmp_path: Path, own_domain: None) -> None:
    source, out = write_folder(tmp_path / "source", 20, 0), tmp_path / "out"
    done = sfr("replay", source, "--start-offset", "0.5", "--duration", "0.5", "--start", "truth", "--out", out)
    assert done.code == 0, done.err
    rows = (out / "estimate.csv").read_text().splitlines()[1:]
    assert [int(row.split(",")[0]) for row in rows] == [START_NS + k * PERIOD_NS for k in range(5, 11)]
    assert "the estimate covers 30 % of the images" in done.out + done.err
