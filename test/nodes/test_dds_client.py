"""A DDS client of another make, without ROS, reads what the nodes publish."""

# ruff: noqa: E402 - ROS or the client may be absent
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("cyclonedds", reason="the DDS client is not installed (extra dev)")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

from made_scene import LOC_RIG, PERIOD_NS, START_NS, loc_pair, true_pose
from nav_msgs.msg import Odometry
from processes import Peer, Process, node_process, wait_until
from scenes import MOUNT, raw, send_infos, send_pair
from std_msgs.msg import Float64, String

from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes.messages.pose import odometry_row

LOOPBACK = (
    '<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex></Discovery>'
    "</Domain></CycloneDDS>"
)
"""ROS with LOCALHOST does not use multicast: the peers are asked one by one."""
MOST, FEWEST, PAUSE_S = 200, 8, 0.1
"""Pairs: the client and the monitor may find localisation late."""


def received(client: Process, topic: str) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in client.text.splitlines() if line.startswith("{") and line.endswith("}")]
    return [line for line in lines if line["topic"] == topic]


@pytest.mark.slow
def test_odometry_and_metrics_have_the_same_numbers_there(ros: None, tmp_path: Path) -> None:
    script = str(Path(__file__).with_name("dds_client.py"))
    conditions = ["-p", "score.trajectory.conditions:=['frames=5']", "-p", "score.trajectory.spacing:=1"]
    with (
        node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as localisation,
        node_process(tmp_path, "monitor_node", "--ros-args", "-p", "publish_period_s:=0.2", *conditions) as monitor,
        Process(
            tmp_path / "client.log",
            script,
            os.environ["ROS_DOMAIN_ID"],
            "200",
            environment={"CYCLONEDDS_URI": LOOPBACK},
        ) as client,
        Peer() as peer,
    ):
        odometry = peer.listen(Odometry, "localisation/odometry")
        means = peer.listen(Float64, "metrics/position/mean")
        reports = peer.listen(String, "metrics/report", latched=True)
        localisation.wait_for("listens to")
        monitor.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)

        def poses() -> int:
            score = json.loads(reports[-1].data) if reports else {}
            return int(score.get("trajectory", {}).get("estimate_poses", 0))

        for index in range(MOST):
            stamp_ns, pose = START_NS + index * PERIOD_NS, true_pose(index)
            truth = bag_messages.odometry(stamp_ns, pose.translation, pose.quat_xyzw)
            peer.publish(Odometry, "ground_truth/odometry", raw(truth))
            send_pair(peer, "loc", loc_pair(index))
            peer.until(lambda count=index: len(odometry) > count, "odometry")
            if len(received(client, "odometry")) >= FEWEST and means and poses() >= FEWEST:
                break
            time.sleep(PAUSE_S)
        last = [odometry_row(message) for message in odometry]
        wait_until(lambda: any(r["stamp_ns"] == last[-1][0] for r in received(client, "odometry")), "the last odometry")
        theirs = {r["stamp_ns"]: r for r in received(client, "odometry")}
        assert len(theirs) >= FEWEST
        for message, (stamp_ns, position, quat) in zip(odometry, last, strict=True):
            if stamp_ns not in theirs:
                continue
            found = theirs[stamp_ns]
            assert (found["frames"], tuple(found["position"])) == (["ds", "rb"], position)
            assert tuple(found["quat"]) == quat
            assert np.array_equal(found["covariance"], message.pose.covariance)

        def agree(topic: str, ours: list[Any]) -> bool:
            theirs = received(client, topic)
            return bool(ours and theirs) and theirs[-1]["data"] == ours[-1].data

        peer.until(lambda: poses() >= FEWEST and agree("report", reports), "the same last report")
        peer.until(lambda: agree("position", means), "the same last figure")
