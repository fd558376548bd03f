"""A DDS client of another make, without ROS, reads what the nodes publish."""

import json
import os
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="the DDS client is not installed (extra dev)")

from nav_msgs.msg import Odometry

from helpers.made_scene import LOC_RIG, loc_pair
from helpers.node_scenes import MOUNT, send_infos, send_pair
from helpers.peer import Peer
from helpers.processes import Process, node_process, wait_until
from sfr_loc_map.ros.pose_messages import odometry_row

LOOPBACK = (
    '<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex></Discovery>'
    "</Domain></CycloneDDS>"
)
"""ROS with LOCALHOST does not use multicast: the peers are asked one by one."""
MOST, FEWEST, PAUSE_S = 200, 5, 0.1
"""Pairs: the client may find localisation late."""


def received(client: Process) -> dict[Any, dict[str, Any]]:
    """Return the whole messages that the client has printed, by stamp, position and orientation."""
    lines = [json.loads(line) for line in client.text.splitlines() if line.startswith("{") and line.endswith("}")]
    return {row_of(message): message for message in lines}


def row_of(message: dict[str, Any]) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    stamp, pose = message["header"]["stamp"], message["pose"]["pose"]
    stamp_ns = stamp["sec"] * 1_000_000_000 + stamp["nanosec"]
    return stamp_ns, tuple(pose["position"].values()), tuple(pose["orientation"].values())


@pytest.mark.slow
def test_odometry_has_the_same_numbers_there(ros: None, tmp_path: Path) -> None:
    variables = {"CYCLONEDDS_URI": LOOPBACK}
    command = ("-m", "helpers.dds_client", os.environ["ROS_DOMAIN_ID"], "200")
    with (
        node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as localisation,
        Process(tmp_path / "client.log", *command, environment=variables) as client,
        Peer() as peer,
    ):
        odometry = peer.listen(Odometry, "localisation/odometry")
        localisation.wait_for("subscribes to")
        send_infos(peer, "loc", LOC_RIG)
        for index in range(MOST):
            send_pair(peer, "loc", loc_pair(index))
            peer.until(lambda count=index: len(odometry) > count, "odometry")
            if len(received(client)) >= FEWEST:
                break
            time.sleep(PAUSE_S)
        ours = {odometry_row(message): message for message in odometry}
        wait_until(lambda: max(ours) in received(client), "the last odometry")
        theirs = received(client)
        assert theirs.keys() <= ours.keys()
        for row, message in theirs.items():
            assert (message["header"]["frame_id"], message["child_frame_id"]) == ("ds", "rb")
            assert message["pose"]["covariance"] == ours[row].pose.covariance.tolist()
