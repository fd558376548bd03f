"""A DDS client of another make, without ROS, reads what the nodes publish."""

import json
import os
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="the DDS client is not installed (extra dev)")

from made_scene import LOC_RIG, PERIOD_NS, START_NS, loc_pair, true_pose
from nav_msgs.msg import Odometry
from processes import Peer, Process, node_process, wait_until
from scenes import MOUNT, params, raw, send_infos, send_pair
from std_msgs.msg import Float64, String

from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes.messages import odometry_row

LOOPBACK = (
    '<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex></Discovery>'
    "</Domain></CycloneDDS>"
)
"""ROS with LOCALHOST does not use multicast: the peers are asked one by one."""
MOST, FEWEST, PAUSE_S = 200, 5, 0.1
"""Pairs: the client and the monitor may find localisation late."""
SCORING = params("publish_period_s:=0.2", "score.trajectory.conditions:=['frames=2']", "score.trajectory.spacing:=1")


def received(client: Process, topic: str) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in client.text.splitlines() if line.startswith("{") and line.endswith("}")]
    return [line for line in lines if line["topic"] == topic]


def row_of(message: dict[str, Any]) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    stamp, pose = message["header"]["stamp"], message["pose"]["pose"]
    stamp_ns = stamp["sec"] * 1_000_000_000 + stamp["nanosec"]
    return stamp_ns, tuple(pose["position"].values()), tuple(pose["orientation"].values())


@pytest.mark.slow
def test_odometry_and_metrics_have_the_same_numbers_there(ros: None, tmp_path: Path) -> None:
    script = str(Path(__file__).with_name("dds_client.py"))
    variables = {"CYCLONEDDS_URI": LOOPBACK}
    with (
        node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as localisation,
        node_process(tmp_path, "monitor_node", "--ros-args", *SCORING) as monitor,
        Process(tmp_path / "client.log", script, os.environ["ROS_DOMAIN_ID"], "200", environment=variables) as client,
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
            if len(received(client, "localisation/odometry")) >= FEWEST and means and poses() >= FEWEST:
                break
            time.sleep(PAUSE_S)
        ours = {odometry_row(message): message for message in odometry}

        def theirs() -> dict[Any, dict[str, Any]]:
            return {row_of(message): message for message in received(client, "localisation/odometry")}

        wait_until(lambda: max(ours) in theirs(), "the last odometry")
        assert theirs().keys() <= ours.keys()
        for row, message in theirs().items():
            assert (message["header"]["frame_id"], message["child_frame_id"]) == ("ds", "rb")
            assert message["pose"]["covariance"] == ours[row].pose.covariance.tolist()

        def agree(topic: str, ours: list[Any]) -> bool:
            theirs = received(client, topic)
            return bool(ours and theirs) and theirs[-1]["data"] == ours[-1].data

        peer.until(lambda: poses() >= FEWEST and agree("metrics/report", reports), "the same last report")
        peer.until(lambda: agree("metrics/position/mean", means), "the same last figure")
