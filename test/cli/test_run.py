"""`sfr run` over DDS: the started nodes, their parameters, their end, and the unit file of the documentation."""

# ruff: noqa: E402 - ROS may be absent
import configparser
import json
import os
import shlex
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.rosbag2 import Reader

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(120), pytest.mark.usefixtures("own_domain")]

from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image
from std_msgs.msg import String

from helpers import ROOT
from helpers.cli_result import Sfr
from helpers.made_scene import LOC_RIG, T_RB_LOCSB, compressed_bag, loc_pair
from helpers.node_scenes import MOUNT, raw, send_infos, send_pair
from helpers.peer import Peer
from helpers.processes import Process, abandoned, has_started_ros, nodes_of, segments_of, wait_until
from sfr_loc_map.cli.main import main
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.ros.messages import message_type
from sfr_loc_map.ros.pose_messages import odometry_row

COMMAND = ("-m", "sfr_loc_map")


@pytest.mark.slow
def test_namespace_remaps_and_parameters_reach_the_nodes_and_ctrl_c_ends_all(tmp_path: Path) -> None:
    import rclpy

    params = tmp_path / "p.yaml"
    params.write_text("/**/localisation_node:\n  ros__parameters:\n    ds_frame: mars\n", encoding="utf-8")
    options = ["--namespace", "rover1", "--params-file", str(params), "-r", "loc/left/image_rect:=/eye/left"]
    rclpy.init(args=[])
    with (
        Process(tmp_path / "log", *COMMAND, "run", "localisation", *options, "--ros-args", *MOUNT) as run,
        Peer() as peer,
    ):
        run.wait_for("/rover1/loc/right/image_rect")
        odometry = peer.listen(Odometry, "/rover1/localisation/odometry")
        send_infos(peer, "loc", LOC_RIG, "/rover1/")
        pair = loc_pair(0)
        peer.publish(Image, "/eye/left", raw(bag_messages.image(pair.stamp_ns, pair.left, "loc", "left")))
        peer.publish(
            Image, "/rover1/loc/right/image_rect", raw(bag_messages.image(pair.stamp_ns, pair.right, "loc", "right"))
        )
        peer.until(lambda: odometry, "odometry")
        assert odometry[0].header.frame_id == "mars"
        (pid,) = nodes_of(run.popen.pid)
        shared = segments_of([pid])
        assert run.end(signal.SIGINT, signal.SIGINT) == 0
        assert not Path(f"/proc/{pid}").exists()
        assert "Traceback" not in run.text
    rclpy.try_shutdown()
    assert shared
    assert not abandoned(shared)


@pytest.fixture
def ended() -> Iterator[ExitStack]:
    """What is called at the end, whatever happened before."""
    with ExitStack() as stack:
        yield stack


@pytest.mark.slow
def test_the_configuration_of_a_bag_of_compressed_topics_runs_the_nodes(
    tmp_path: Path, sfr: Sfr, ended: ExitStack
) -> None:
    """Of a recording to `init`, of its configuration to the nodes: their poses are those of the bag."""
    import rclpy

    bag = compressed_bag(tmp_path, 6)
    made = sfr("init", tmp_path / "mine", "--from", bag)
    assert made.code == 0, made.err
    config = tmp_path / "mine" / "sfr.yaml"
    offline = sfr("localise", bag, "-o", tmp_path / "offline.csv", "--config", config)
    assert offline.code == 0, offline.err
    rclpy.init(args=[])
    ended.callback(rclpy.try_shutdown)
    command = (*COMMAND, "run", "localisation", "monitor", "--config", str(config))
    with Process(tmp_path / "log", *command) as run, Peer() as peer, Reader(bag) as reader:
        run.wait_for("/front/right/image_raw/compressed")
        odometry = peer.listen(Odometry, "localisation/odometry")
        report = peer.listen(String, "metrics/report", latched=True)
        for node in ("localisation_node", "monitor_node"):
            peer.wait_until_known_to(node)
        messages = [(item.topic, item.msgtype, bytes(data)) for item, _, data in reader.messages()]
        messages.sort(key=lambda item: not item[0].endswith("camera_info"))  # cameras send them before the first image
        unanswered: list[tuple[type[Any], str, bytes]] = []
        sent = 0
        for topic, kind, data in messages:
            if kind.startswith(("sensor_msgs/msg/C", "nav_msgs/")):
                unanswered.append((message_type(kind), topic, data))
            if topic != "/front/right/image_raw/compressed":
                continue
            sent += 1
            while len(odometry) < sent:  # best effort: what is sent before both sides are matched is lost
                for item in unanswered:
                    peer.publish(*item)
                peer.spin(2.0, lambda count=sent: len(odometry) >= count)
            unanswered.clear()
        for item in unanswered:
            peer.publish(*item)
        live = [odometry_row(message)[1] for message in odometry]
        expected = read_trajectory_file(tmp_path / "offline.csv").trajectory.positions
        assert live == [tuple(position) for position in expected.tolist()]

        def is_scored() -> bool:
            return bool(report) and (json.loads(report[-1].data).get("association") or {}).get("matched") == 6

        truths = [(message_type(kind), topic, data) for topic, kind, data in messages if kind.startswith("nav_msgs/")]
        for _ in range(30):
            peer.spin(2.0, is_scored)
            if is_scored():
                break
            for item in truths:  # a pose that was sent before the monitor was matched is lost
                peer.publish(*item)
        assert is_scored()
        assert "Traceback" not in run.text
        assert run.end(signal.SIGINT, signal.SIGINT) == 0


@pytest.mark.slow
def test_a_node_does_not_outlive_a_command_that_is_killed(tmp_path: Path) -> None:
    with Process(tmp_path / "log", *COMMAND, "run", "monitor", "--log-level", "info") as run:
        (pid,) = wait_until(lambda: nodes_of(run.popen.pid), "the node")
        wait_until(lambda: has_started_ros(pid), "the start of the node")
        assert run.end(signal.SIGKILL) == -signal.SIGKILL
    wait_until(lambda: not Path(f"/proc/{pid}").exists(), "the end of the node")


@pytest.mark.slow
def test_a_node_that_dies_ends_the_others_or_is_started_again(tmp_path: Path) -> None:
    for respawn in (False, True):
        options = ["--respawn"] * respawn
        with Process(tmp_path / f"log{respawn}", *COMMAND, "run", "monitor", "mapping", *options) as run:
            pids = wait_until(lambda run=run: len(nodes_of(run.popen.pid)) == 2 and nodes_of(run.popen.pid), "two")
            os.kill(pids[0], signal.SIGKILL)  # also a node that is still being started
            if not respawn:
                assert run.popen.wait(60) == 2
                assert "was killed by SIGKILL: its output is above" in run.text.splitlines()[-1]
                assert not Path(f"/proc/{pids[1]}").exists()
                continue
            run.wait_for("was killed by SIGKILL: restarted")
            new = wait_until(lambda run=run: len(nodes_of(run.popen.pid)) == 2 and nodes_of(run.popen.pid), "both")
            assert pids[1] in new
            wait_until(lambda new=new: all(map(has_started_ros, new)), "the start of the node")
            time.sleep(0.2)
            assert run.end(signal.SIGTERM) == 0


@pytest.mark.slow
def test_what_cannot_start_is_one_line_of_the_node_and_one_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (["mapper"], ["--params-file", "/nowhere.yaml"]):
        monkeypatch.setattr(sys, "argv", ["sfr", "run", *words])
        assert main() == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    command = ["run", "monitor", "--respawn", "--ros-args", "-p", "publish_periods:=1"]
    with Process(tmp_path / "log", *COMMAND, *command) as run:
        assert run.popen.wait(60) == 2
        node, command_line = run.text.strip().splitlines()
        assert "unknown key 'publish_periods'" in node
        assert "monitor_node ended with exit code 2" in command_line


@pytest.mark.slow
def test_the_unit_file_starts_the_nodes_and_ends_them_as_it_says(tmp_path: Path) -> None:
    """What systemd would do: start ExecStart, send KillSignal to it alone, wait TimeoutStopSec, judge the exit code."""
    import rclpy

    unit = configparser.ConfigParser(interpolation=None, strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(ROOT / "config" / "examples" / "sfr.service")
    service = unit["Service"]
    assert (service["KillMode"], service["Restart"], service["Type"]) == ("mixed", "on-failure", "simple")
    program, *words = shlex.split(service["ExecStart"])
    assert program.endswith("/bin/sfr")
    report, pose, settings = (tmp_path / name for name in ("report.json", "pose.json", "rover.yaml"))
    words = [str(settings) if word == "/etc/sfr/rover.yaml" else word for word in words]
    assert str(settings) in words
    mount = {"translation_m": T_RB_LOCSB.translation.tolist(), "quat_xyzw": T_RB_LOCSB.file_quat_xyzw.tolist()}
    parameters = {
        "localisation": {"resume_file": str(pose), "T_rb_locsb": mount, "input": {"reliability": "reliable"}},
        "monitor": {"save_file": str(report), "save_period_s": 0.2},
    }
    blocks = {f"/**/{name}_node": {"ros__parameters": values} for name, values in parameters.items()}
    settings.write_text(yaml.safe_dump(blocks), encoding="utf-8")
    with Process(tmp_path / "log", *COMMAND, *words) as run:
        for name in ("localisation", "mapping", "monitor"):
            run.wait_for(f"[{name}_node]: subscribes to")
        pids = nodes_of(run.popen.pid)
        rclpy.init(args=[])
        try:
            with Peer() as peer:
                pairs = count()

                def kept() -> bool:  # what comes once is lost to a node that has not found its writer yet
                    send_infos(peer, "loc", LOC_RIG)
                    send_pair(peer, "loc", loc_pair(next(pairs)))
                    return report.exists() and pose.exists()

                peer.until(kept, "what the nodes keep")
        finally:
            rclpy.try_shutdown()
        begin = time.monotonic()
        assert run.end(signal.Signals[service["KillSignal"]]) == 0
        assert time.monotonic() - begin < float(service["TimeoutStopSec"])
        assert len(pids) == 3
        assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert service["RestartPreventExitStatus"] == "2"  # of what cannot start: see above
