"""`sfr record` of a rover that publishes over DDS: ended by a signal, by kill -9, and by a full disk."""

# ruff: noqa: E402 - ROS may be absent
from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from signal import SIGINT, SIGKILL, SIGTERM

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(120), pytest.mark.usefixtures("own_domain")]

from rosbags.highlevel import AnyReader

from helpers.processes import Process, wait_until
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.registry import open_source

COMMAND = ("-m", "sfr_loc_map")
IMAGES = ["loc/left/image_rect", "loc/right/image_rect"]


@pytest.fixture
def rover(own_domain: None, tmp_path: Path) -> Iterator[Process]:
    with Process(tmp_path / "rover.log", "-m", "helpers.rover_process", "good") as process:
        process.wait_for("ready")
        yield process
        process.popen.terminate()
        process.popen.wait(60)


def readable(path: Path) -> int:
    """Return how many images can be read while the recording goes on."""
    if not list(path.glob("*.mcap")):
        return 0
    try:
        return sum(1 for _ in Bag(path).raw_messages(IMAGES))
    except Exception:
        return 0


@pytest.mark.slow
def test_the_end_on_request_leaves_a_source_for_all_else(rover: Process, tmp_path: Path) -> None:
    out = tmp_path / "drive.mcap"
    with Process(tmp_path / "log", *COMMAND, "record", str(out)) as process:
        process.wait_for("recording /ground_truth/odometry")
        wait_until(lambda: readable(out) > 20, "images")
        assert process.end(SIGINT, SIGTERM, pause_s=0.0) == 0, process.text
        *_, counted, advice = process.text.splitlines()
        assert "messages of 5 topics, 0 lost" in counted
        assert advice.startswith("next: sfr info")
    assert (out / "metadata.yaml").exists()
    source = open_source(out)
    assert source.loc is not None
    assert len(source.loc) >= 10
    with AnyReader([out]) as reader:
        assert {c.topic for c in reader.connections} == {f"/{n}" for n in (*IMAGES, "ground_truth/odometry")} | {
            f"/loc/{side}/camera_info" for side in ("left", "right")
        }
        assert all(c.msgdef.data for c in reader.connections)


@pytest.mark.slow
def test_kill_9_leaves_what_any_reader_reads(rover: Process, tmp_path: Path) -> None:
    out = tmp_path / "drive.mcap"
    with Process(tmp_path / "log", *COMMAND, "record", str(out), "--all") as process:
        wait_until(lambda: readable(out) > 20, "images")
        process.end(SIGKILL)
    variables = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    subprocess.run(["fastdds", "shm", "clean"], env=variables, capture_output=True, timeout=60, check=False)
    (file,) = out.glob("*.mcap")
    with AnyReader([file]) as reader:  # another reader, without any repair
        theirs = [stamp for connection, stamp, _ in reader.messages() if connection.topic == "/loc/left/image_rect"]
        assert "/rosout" in reader.topics
    ours = [stamp for name, _, stamp, _ in Bag(out).raw_messages(IMAGES[:1])]
    assert len(ours) == len(theirs)
    assert len(open_source(out).loc or ()) >= 10
