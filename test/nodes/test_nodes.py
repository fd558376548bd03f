"""The nodes as processes over DDS: what comes out, and what they survive."""

# ruff: noqa: E402 - ROS may be absent
import json
import math
from pathlib import Path
from signal import SIGCONT, SIGINT, SIGSTOP, SIGTERM

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from made_scene import LOC_RIG, NAV_RIG, PERIOD_NS, START_NS, loc_pair, nav_pair, true_pose
from nav_msgs.msg import Odometry
from processes import ReferenceMethod, node_process
from scenes import MOUNT, calls, disparity_of, problems, raw, send_infos, send_pair
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Float64, String
from stereo_msgs.msg import DisparityImage

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io import bag_messages
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.nodes.diagnostics.key_values import values_of
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.point_cloud import cloud_from_msg
from sfr_loc_map.nodes.messages.pose import odometry_row, pose_msg


def test_localisation_in_a_namespace_with_remapping_and_a_parameter_file(ros: None, tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(
        "/**/localisation_node:\n  ros__parameters:\n    ds_frame: world\n    rb_frame: rover\n"
        "    localisation:\n      max_features: 300\n",
        encoding="utf-8",
    )
    arguments = ["--ros-args", "--params-file", str(file), "-r", "__ns:=/rover1", *MOUNT]
    arguments += ["-r", "loc/left/image_rect:=/cam/l", "-r", "initialpose:=/start"]
    with node_process(tmp_path, "localisation_node", *arguments) as node, ReferenceMethod() as peer:
        odometry = peer.listen(Odometry, "/rover1/localisation/odometry")
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        node.wait_for("listens to")
        (line,) = [line for line in node.text.splitlines() if "listens to" in line]
        for name in (
            "/start",
            "/cam/l",
            "/rover1/loc/right/camera_info",
            "/rover1/localisation/odometry",
            "/diagnostics",
        ):
            assert name in line
        first = Transform.from_quat(true_pose(0).translation, true_pose(0).quat_xyzw)
        start = PoseWithCovarianceStamped(header=header_msg(0, "world"))
        start.pose.pose = pose_msg(first, first.file_quat_xyzw)
        peer.publish(PoseWithCovarianceStamped, "/start", start, arrival=True)
        send_infos(peer, "loc", LOC_RIG, "/rover1/")
        localiser = Localiser(LOC_RIG, LocalisationConfig(max_features=300), first)
        for index in range(4):
            pair = loc_pair(index)
            peer.publish(Image, "/cam/l", raw(bag_messages.image(pair.stamp_ns, pair.left, "loc", "left")))
            right = raw(bag_messages.image(pair.stamp_ns, pair.right, "loc", "right"))
            peer.publish(Image, "/rover1/loc/right/image_rect", right)
            peer.until(lambda index=index: len(odometry) > index and len(calls(diagnostics)) > index, "odometry")
            expected = localiser.process(pair)
            stamp, position, quat = odometry_row(odometry[index])
            assert (stamp, position) == (pair.stamp_ns, tuple(expected.T_ds_rb.translation))
            assert quat == tuple(expected.T_ds_rb.quat_xyzw)
            covariance = np.array(odometry[index].pose.covariance).reshape(6, 6)
            assert np.array_equal(covariance, expected.covariance)
            status = calls(diagnostics)[index]
            values = values_of(status)
            assert (status.name, values["state"]) == ("rover1/localisation_node: call", expected.state.value)
            assert int(values["stamp_ns"]) == pair.stamp_ns
            assert float(values["processing_time_s"]) > 0
            assert int(values["peak_rss_bytes"]) > 50e6
        assert (odometry[0].header.frame_id, odometry[0].child_frame_id) == ("world", "rover")
        error = np.linalg.norm(np.array(odometry_row(odometry[3])[1]) - true_pose(3).translation)
        assert error < 0.02
        assert node.end(SIGINT) == 0


def test_localisation_survives_what_the_network_may_send(ros: None, tmp_path: Path) -> None:
    with node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as node, ReferenceMethod() as peer:
        odometry = peer.listen(Odometry, "localisation/odometry")
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        node.wait_for("listens to")
        bad = bag_messages.camera_info(START_NS, LOC_RIG, "loc", "left")
        bad.d[0] = 0.1
        peer.publish(CameraInfo, "loc/left/camera_info", raw(bad))
        right_info = raw(bag_messages.camera_info(START_NS, LOC_RIG, "loc", "right"))
        peer.publish(CameraInfo, "loc/right/camera_info", right_info)
        peer.until(lambda: any("non-rectified" in text for text in problems(diagnostics)), "refusal of camera_info")
        send_infos(peer, "loc", LOC_RIG)
        good = raw(bag_messages.image(START_NS, loc_pair(0).left, "loc", "left"))
        for broken in (good[: len(good) // 2], b"\0\1\0", b"\xff" * 64):
            peer.publish(Image, "loc/left/image_rect", broken)
        size = {"height": 120, "width": 160, "data": bytes(160 * 120)}
        pictures = {
            "its camera_info says": {"height": 2**31, "width": 2**31, "step": 2**31},
            "too few": {**size, "step": 2**31, "encoding": "mono8"},
            "encoding 'bayer_rggb8'": {**size, "step": 160, "encoding": "bayer_rggb8"},
        }
        for number, (words, fields) in enumerate(pictures.items()):
            stamp = START_NS - PERIOD_NS * (len(pictures) - number)
            for side in ("left", "right"):
                peer.publish(Image, f"loc/{side}/image_rect", Image(header=header_msg(stamp, ""), **fields))
            peer.until(lambda words=words: any(words in text for text in problems(diagnostics)), words)
        nowhere = PoseWithCovarianceStamped(header=header_msg(0, "ds"))
        nowhere.pose.pose.position.x = math.nan
        peer.publish(PoseWithCovarianceStamped, "initialpose", nowhere)
        send_pair(peer, "loc", loc_pair(0))
        peer.until(lambda: odometry, "odometry after all that")
        _, position, quat = odometry_row(odometry[0])
        assert (*position, *quat) == pytest.approx((0, 0, 0, 0, 0, 0, 1), abs=1e-12)
        assert len(odometry) == 1
        assert node.end(SIGTERM, SIGINT) == 0


def test_localisation_starts_anew_by_service_by_pose_and_when_stamps_go_back(ros: None, tmp_path: Path) -> None:
    with node_process(tmp_path, "localisation_node", "--ros-args", *MOUNT) as node, ReferenceMethod() as peer:
        odometry = peer.listen(Odometry, "localisation/odometry")
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)

        def play(index: int, shift_ns: int = 0) -> tuple[float, ...]:
            pair = loc_pair(index)
            count = len(odometry)
            send_pair(peer, "loc", type(pair)(pair.stamp_ns + shift_ns, pair.left, pair.right))
            peer.until(lambda: len(odometry) > count, "odometry")
            return odometry_row(odometry[-1])[1]

        def set_pose(index: int) -> None:
            message = PoseWithCovarianceStamped()
            message.pose.pose = pose_msg(true_pose(index), true_pose(index).quat_xyzw)
            peer.publish(PoseWithCovarianceStamped, "initialpose", message, arrival=True)
            peer.spin(0.3)

        assert play(0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
        play(1)
        set_pose(1)
        assert play(2) == pytest.approx(true_pose(2).translation, abs=0.02)
        assert play(0, -10 * PERIOD_NS - 10**9) == pytest.approx(true_pose(1).translation, abs=1e-9)
        assert "stamps have gone back" in node.text
        assert peer.call("localisation_node/reset").success
        assert play(5) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_pictures_that_the_node_has_no_room_for_are_counted(ros: None, tmp_path: Path) -> None:
    arguments = ["--ros-args", *MOUNT, "-p", "input.queue_depth:=3"]
    with node_process(tmp_path, "localisation_node", *arguments) as node, ReferenceMethod() as peer:
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        node.wait_for("listens to")
        send_infos(peer, "loc", LOC_RIG)
        send_pair(peer, "loc", loc_pair(0))
        peer.until(lambda: len(calls(diagnostics)) == 1, "the first pair")
        node.popen.send_signal(SIGSTOP)
        for index in range(1, 11):
            send_pair(peer, "loc", loc_pair(index))
        peer.spin(0.5)
        node.popen.send_signal(SIGCONT)
        last = str(loc_pair(10).stamp_ns)
        peer.until(lambda: values_of(calls(diagnostics)[-1])["stamp_ns"] == last, "the last pair")
        values = values_of(calls(diagnostics)[-1])
        dropped = int(values["dropped_in_transport"]) + int(values["dropped_unpaired"])
        assert dropped == 2 * (11 - len(calls(diagnostics)))
        assert dropped > 0


def test_localisation_without_the_place_of_its_cameras_says_what_is_missing(ros: None, tmp_path: Path) -> None:
    with node_process(tmp_path, "localisation_node") as node, ReferenceMethod() as peer:
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        odometry = peer.listen(Odometry, "localisation/odometry")
        node.wait_for("the extrinsics of the stereo rig (parameters T_rb_locsb) are not given")
        send_infos(peer, "loc", LOC_RIG)
        send_pair(peer, "loc", loc_pair(0))
        peer.until(lambda: any("T_rb_locsb.translation_m" in text for text in problems(diagnostics)), "the error")
        assert not odometry


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "T_rb_locsb.quat_xyzw:=[0.0, 0.0, 0.0, 2.0]"], "a unit quaternion is needed"),
        (["-p", "T_rb_locsb.translation_m:=[1.0, 0.0, 0.0]"], "give both"),
        (["-p", "localisation.max_feature:=3"], "unknown key 'localisation.max_feature'"),
        (["-p", "input.image_transport:=theora"], "must be one of raw, compressed, auto"),
    ],
)
def test_parameters_that_are_not_valid_are_one_line_and_exit_2(
    tmp_path: Path, arguments: list[str], words: str
) -> None:
    with node_process(tmp_path, "localisation_node", "--ros-args", *arguments) as node:
        assert node.popen.wait(60) == 2
        assert words in node.text
        assert len(node.text.strip().splitlines()) == 1


def send_nav(peer: ReferenceMethod, index: int, *, pose: bool = True) -> None:
    item = nav_pair(index)
    if pose:
        message = raw(bag_messages.pose(item.pair.stamp_ns, item.T_lm_navsb))
        peer.publish(PoseStamped, "nav/pose", message)
    send_pair(peer, "nav", item.pair)


def test_mapping_makes_disparities_and_clouds_of_sets_of_pairs(ros: None, tmp_path: Path) -> None:
    arguments = ["--ros-args", "-p", "pairs_per_map:=2", "-p", "pose_wait_s:=1.0"]
    with node_process(tmp_path, "mapping_node", *arguments) as node, ReferenceMethod() as peer:
        clouds = peer.listen(PointCloud2, "mapping/points")
        disparities = peer.listen(DisparityImage, "mapping/disparity")
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        node.wait_for("listens to")
        send_infos(peer, "nav", NAV_RIG)
        mapper = Mapper(NAV_RIG, MappingConfig())
        maps = [mapper.process(nav_pair(i).pair, nav_pair(i).T_lm_navsb, i % 2) for i in range(3)]
        for index in range(3):
            send_nav(peer, index)
            peer.until(lambda index=index: len(disparities) > index, "disparity")
            found = disparity_of(disparities[index])
            assert np.array_equal(found, maps[index].disparity_px, equal_nan=True)
        peer.until(lambda: clouds, "the first cloud")
        expected = mapper.fuse(maps[:2]).cloud.to_structured()
        assert np.array_equal(cloud_from_msg(clouds[0]).to_structured(), expected)
        assert clouds[0].header.frame_id == "lm"
        send_nav(peer, 3, pose=False)
        peer.until(lambda: any("no nav/pose of its stamp" in text for text in problems(diagnostics)), "the bound")
        answer = peer.call("mapping_node/finish")
        assert answer.success
        peer.until(lambda: len(clouds) == 2, "the second cloud")
        expected = mapper.fuse(maps[2:]).cloud.to_structured()
        assert np.array_equal(cloud_from_msg(clouds[1]).to_structured(), expected)
        assert not peer.call("mapping_node/finish").success
        assert [values_of(status)["state"] for status in calls(diagnostics)] == [
            "mapped",
            "mapped",
            "fused",
            "mapped",
            "fused",
        ]
        assert node.end(SIGINT, SIGINT) == 0


def test_mapping_of_more_than_three_pairs_is_refused(tmp_path: Path) -> None:
    with node_process(tmp_path, "mapping_node", "--ros-args", "-p", "pairs_per_map:=4") as node:
        assert node.popen.wait(60) == 2
        assert "'pairs_per_map' is 4: must lie in 1 .. 3" in node.text


def test_monitor_scores_what_it_hears(ros: None, tmp_path: Path) -> None:
    save = tmp_path / "score.json"
    limits = tmp_path / "limits.yaml"
    limits.write_text("trajectory:\n - condition: frames=5\n   position_mean_plus_3sigma_m: 0.001\n", encoding="utf-8")
    arguments = [
        "--ros-args",
        "-p",
        f"save_file:={save}",
        "-p",
        f"limits_file:={limits}",
        "-p",
        "publish_period_s:=0.1",
    ]
    arguments += ["-p", "score.trajectory.conditions:=['frames=5']", "-p", "score.trajectory.spacing:=5"]
    with node_process(tmp_path, "monitor_node", *arguments) as node, ReferenceMethod() as peer:
        report = peer.listen(String, "metrics/report", latched=True)
        means = peer.listen(Float64, "metrics/position/mean")
        metrics = peer.listen(DiagnosticArray, "metrics")
        node.wait_for("listens to")
        for index in range(21):
            for topic, stretch in (("ground_truth/odometry", 1.0), ("localisation/odometry", 1.01)):
                place = np.array([0.1 * index * stretch, 0.0, 0.0])
                message = bag_messages.odometry(START_NS + index * PERIOD_NS, place, np.array([0.0, 0.0, 0.0, 1.0]))
                peer.publish(Odometry, topic, raw(message))

        def whole() -> dict | None:
            score = json.loads(report[-1].data) if report else {}
            return score if score.get("trajectory", {}).get("matched") == 21 else None

        score = peer.until(whole, "the report")
        # 5 frames are 0.5 m; 1 % too long: 5 mm each time, without spread.
        assert score["trajectory"]["count"] == 4
        assert score["trajectory"]["position_m"]["mean"] == pytest.approx(0.005, abs=1e-12)
        assert score["trajectory"]["position_m"]["sigma"] == pytest.approx(0.0, abs=1e-12)
        assert score["verdicts"][0]["verdict"] == "fail"
        peer.until(lambda: means and means[-1].data == score["trajectory"]["position_m"]["mean"], "the figure")

        def verdicts() -> list[tuple[bytes, str]]:
            statuses = metrics[-1].status if metrics else []
            return [(status.level, status.message) for status in statuses if status.name.startswith("verdict/")]

        peer.until(lambda: verdicts() == [(b"\x02", "fail")], "the verdict")
        answer = peer.call("monitor_node/save")
        assert (answer.success, answer.message) == (True, str(save))
        saved = json.loads(save.read_text())
        assert saved["trajectory"] == score["trajectory"]
        assert saved["provenance"]["configuration"]["monitor"]["score.trajectory.spacing"] == 5
        assert peer.call("monitor_node/reset").success
        peer.until(lambda: "trajectory" not in json.loads(report[-1].data), "the reset")
        assert node.end(SIGINT) == 0
