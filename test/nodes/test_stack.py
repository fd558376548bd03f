"""Our nodes among those of others: cameras not quite synchronous, tools of ROS, all nodes in one process."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseStamped, TransformStamped
from lifecycle_msgs.msg import Transition
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import String

from helpers import ROOT
from helpers.made_scene import LOC_RIG, NAV_RIG, PERIOD_NS, T_RB_LOCSB, loc_pair, nav_pair
from helpers.manager import Capture, LocalNode, Manager, localised
from helpers.node_scenes import MOUNT, params, raw, send_infos, send_pair
from helpers.score_rows import number
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import Level
from sfr_loc_map.nodes.lifecycle import managed_node
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.mapping_node import MappingNode
from sfr_loc_map.nodes.monitor_node import MonitorNode
from sfr_loc_map.suite_names import Side


def send_image(peer: Manager, index: int, side: Side, late_ns: int = 0) -> None:
    pair = loc_pair(index)
    image = pair.left if side == "left" else pair.right
    message = raw(bag_messages.image(pair.stamp_ns + late_ns, image, "loc", side))
    peer.publish(Image, f"loc/{side}/image_rect", message)


@pytest.mark.slow
def test_two_cameras_that_are_8_ms_apart_are_localised_and_those_further_apart_named_as_by_the_doctor(
    ros: None, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(managed_node, "LOG_PERIOD_S", 1.0)
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT) as node:
        node.wait_for("Waiting for 4 topics (no publisher): /loc/left/image_rect, /loc/left/camera_info, ")
        send_infos(peer, "loc", LOC_RIG)
        for index, late_ms in enumerate((0.0, 0.1, -3.0, 8.0)):
            send_image(peer, index, "left")
            send_image(peer, index, "right", int(late_ms * 1e6))
            peer.until(lambda n=index + 1: len(peer.odometry) == n, "odometry")
        assert peer.positions() == localised([0, 1, 2, 3])
        doctor = subprocess.Popen(
            [sys.executable, "-m", "sfr_loc_map", "doctor", "--seconds", "1", "--json", "-"],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        for index in range(4, 400):  # on a busy host the doctor starts late
            for side, late_ns in (("left", 0), ("right", PERIOD_NS // 2)):
                send_image(peer, index, side, late_ns)
            peer.spin(0.1)
            if doctor.poll() is not None and "the time of one trigger" in node.text:
                break
        assert len(peer.odometry) == 4
        assert doctor.stdout is not None
        found = {item["cause"]: item for item in json.loads(doctor.stdout.read())["issues"]}["unsynchronised"]
        assert found["where"] == "loc/left/image_rect, loc/right/image_rect"
        assert (
            "left and right images of 'loc' are 50 ms apart: at most 10 ms is allowed (input.stamp_tolerance_s)"
            in node.text
        )
        peer.well(Level.WARN, "stamp both images with the time of one trigger")


def test_a_source_that_has_ended_is_named_ever_more_seldom(
    ros: None, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(managed_node, "LOG_PERIOD_S", 1e6)  # looks around when it is told to
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT) as node:
        node.node.report_periodically()
        assert "Waiting for 4 topics (no publisher): /loc/left/image_rect" in node.text
        send_infos(peer, "loc", LOC_RIG)
        for index in range(2):
            peer.play(index)
            node.node.worker.wait_idle()
            for _ in range(1 + 100):  # the first has the call; then silence for 100 periods: said after 1, 2, 4, .. 64
                node.node.report_periodically()
            assert node.text.count("The source has ended or is silent. Waiting for 2 topics") == 7 * (index + 1)
        peer.well(Level.WARN, "The source has ended or is silent. Waiting for 2 topics (the publisher /peer exists")


def test_a_dump_of_the_node_is_taken_back_and_a_change_is_refused(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT):
        names = peer.ask(ListParameters, "list_parameters", ListParameters.Request()).result.names
        values = peer.ask(GetParameters, "get_parameters", GetParameters.Request(names=names)).values
        dump = [ParameterMsg(name=name, value=value) for name, value in zip(names, values, strict=True)]
        dump = [item for item in dump if item.name != "start_type_description_service"]  # which every ROS node refuses
        results = peer.ask(SetParameters, "set_parameters", SetParameters.Request(parameters=dump)).results
        assert [result.reason for result in results if not result.successful] == []
        assert {"autostart", "use_sim_time", "queue_size", "T_rb_locsb.quat_xyzw"} <= set(names)
        assert "'queue_size' is read-only while the node is active" in peer.set(queue_size=7)
        assert "read-only" in peer.set(autostart=False)


EXAMPLES = ROOT / "config" / "examples"
KINDS = {
    "Odometry": "nav_msgs/msg/Odometry",
    "Path": "nav_msgs/msg/Path",
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "Map": "nav_msgs/msg/OccupancyGrid",
    "SetInitialPose": "geometry_msgs/msg/PoseWithCovarianceStamped",
}
FILTER = {
    *("frequency", "sensor_timeout", "two_d_mode", "transform_time_offset", "transform_timeout", "print_diagnostics"),
    *("debug", "debug_out_file", "permit_corrected_publication", "publish_acceleration", "publish_tf", "map_frame"),
    *("odom_frame", "base_link_frame", "base_link_frame_output", "world_frame", "predict_to_current_time", "tf_prefix"),
    *("smooth_lagged_data", "history_length", "reset_on_time_jump", "use_control", "initial_state"),
    *("process_noise_covariance", "initial_estimate_covariance", "dynamic_process_noise_covariance"),
    *("gravitational_acceleration", "disabled_at_startup"),
}
"""Parameters of ekf_node, by the sources of robot_localization (branch ros2)."""
OF_ODOMETRY = (
    *("config", "differential", "relative", "queue_size", "pose_use_child_frame"),
    *("pose_rejection_threshold", "twist_rejection_threshold"),
)


def example(name: str) -> dict[str, Any]:
    """Return the parameters in an example, by node."""
    found = yaml.safe_load((EXAMPLES / name).read_text(encoding="utf-8"))
    while "ros__parameters" not in found:
        (found,) = found.values()
    return dict(found["ros__parameters"])


def test_the_filter_fuses_the_velocity_by_parameters_that_it_has() -> None:
    given = example("robot_localization_ekf.yaml")
    sensors = {name for name in given if name.startswith("odom0")}
    assert set(given) - FILTER == sensors == {"odom0", *(f"odom0_{n}" for n in OF_ODOMETRY if f"odom0_{n}" in given)}
    rows = np.reshape(given["odom0_config"], (5, 3))  # position, attitude, velocity, turn rate, acceleration
    assert rows.all(axis=1).tolist() == rows.any(axis=1).tolist() == [False, False, True, True, False]
    assert given["world_frame"] == given["odom_frame"]


def test_transforms_of_others_disturb_nothing_and_ours_can_be_left_to_a_filter(ros: None, capfd: Capture) -> None:
    """Beside a robot_state_publisher; then with publish_tf off, beside a filter that publishes the same frames."""
    kind = pytest.importorskip("tf2_msgs.msg", reason="not part of the ROS wheels").TFMessage
    with Manager() as peer:
        seen = peer.listen(kind, "/tf")
        other = peer.node.create_publisher(kind, "/tf", 100)
        for index, publishes in enumerate((True, False)):
            names = params(f"publish_tf:={publishes}", "ds_frame:=odom", "rb_frame:=base_link")
            with LocalNode(peer, capfd, LocalisationNode, *MOUNT, *names):
                send_infos(peer, "loc", LOC_RIG)
                ours = [("odom", "base_link", loc_pair(2 * index + n).stamp_ns) for n in range(2)]
                for n in range(2):
                    wheel = TransformStamped(child_frame_id="wheel")
                    wheel.header.frame_id = "base_link"
                    other.publish(kind(transforms=[wheel]))
                    peer.play(2 * index + n)
                peer.spin(0.3)
                assert peer.positions()[-2:] == localised([2 * index, 2 * index + 1])
                sent = [(t.header.frame_id, t.child_frame_id, stamp_of(t)) for m in seen for t in m.transforms]
                assert [item for item in sent if item[1] != "wheel"] == ours * publishes
                seen.clear()


@pytest.mark.slow
def test_three_nodes_in_one_process_localise_map_and_score_for_a_manager_and_programs_of_others(
    ros: None, capfd: Capture
) -> None:
    """As Nav2's lifecycle manager starts and stops them, with the topics and types of the examples."""
    waits = params("autostart:=false")
    manager = example("nav2_lifecycle.yaml")
    assert manager["bond_timeout"] == 0.0
    with (
        Manager() as peer,
        LocalNode(peer, capfd, LocalisationNode, *MOUNT, *waits),
        LocalNode(peer, capfd, MappingNode, *params("input.reliability:=reliable", "pairs_per_map:=2"), *waits),
        LocalNode(peer, capfd, MonitorNode, *params("publish_period_s:=0.2"), *waits),
    ):

        def take(names: list[str], *steps: tuple[int, str]) -> None:
            for transition, state in steps:
                for peer.name in names:
                    assert peer.change(transition) == (True, state)

        take(manager["node_names"], (Transition.TRANSITION_CONFIGURE, "inactive"))
        take(manager["node_names"], (Transition.TRANSITION_ACTIVATE, "active"))
        clouds, reports = (
            peer.listen(PointCloud2, "mapping/points", latched=True),
            peer.listen(String, "metrics/report"),
        )
        send_infos(peer, "loc", LOC_RIG)
        for index in range(3):
            true = bag_messages.odometry(loc_pair(index).stamp_ns, T_RB_LOCSB.translation, T_RB_LOCSB.quat_xyzw)
            peer.publish(Odometry, "ground_truth/odometry", raw(true))
            peer.play(index)
        for index in range(2):
            item = nav_pair(index)
            send_infos(peer, "nav", NAV_RIG)
            peer.publish(PoseStamped, "nav/pose", raw(bag_messages.pose(item.pair.stamp_ns, item.T_lm_navsb)))
            send_pair(peer, "nav", item.pair)
        peer.until(lambda: clouds and clouds[-1].width > 1000, "a cloud")
        assert clouds[-1].point_step % 4 == 0
        for count, task in ((3, "localisation"), (2, "mapping")):
            peer.until(lambda n=count, t=task: number(latest(reports), t, "n") == n, f"{count} of {task}")
        text = (EXAMPLES / "sfr.rviz").read_text(encoding="utf-8")
        used = {
            f"/{topic}": KINDS[name]
            for name, topic in re.findall(r"plugins/(\w+)\n[^-]*?Topic: {Value: ([\w/]+)", text)
        }
        assert len(used) == 6
        used |= {example("nav2_costmap.yaml")["hazard_layer"]["map_topic"]: KINDS["Map"]}
        used |= {f"/{example('robot_localization_ekf.yaml')['odom0']}": KINDS["Odometry"]}
        there = {name: types for name, types in peer.node.get_topic_names_and_types() if name in used}
        assert there == {name: [kind] for name, kind in used.items()}
        backwards = manager["node_names"][::-1]
        take(backwards, (Transition.TRANSITION_DEACTIVATE, "inactive"))
        take(backwards, (Transition.TRANSITION_CLEANUP, "unconfigured"))
        take(backwards, (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, "finalized"))


def latest(reports: list[String]) -> dict:
    return json.loads(reports[-1].data) if reports else {"figures": []}
