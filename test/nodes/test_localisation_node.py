"""The localisation node over DDS: what it publishes, and what it survives."""

import math
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMsg
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from campaigns import malformed_messages
from helpers import ROOT
from helpers.made_scene import LOC_RIG, PERIOD_NS, START_NS, forged, loc_pair, true_pose
from helpers.manager import Capture, LocalNode, Manager, localised
from helpers.node_scenes import MOUNT, calls, params, raw, send_infos, send_pair
from helpers.peer import Peer
from sfr_loc_map.calls.call_message import decode_call
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.io.calibration.rectification import rig_of_infos
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.visualisation import draw_tracks
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import Level
from sfr_loc_map.nodes.localisation.odometry_buffer import OdometryBuffer
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.point_messages import tracks_from_msg
from sfr_loc_map.ros.pose_messages import covariance_of, odometry_row, pose_msg, transform_from_pose
from sfr_loc_map.ros.statuses import values_of
from sfr_loc_map.suite_names import SIDES, Task

CONFIG = ROOT / "config"
OTHER_FRAME = Transform.from_quat([7.0, -2.0, 1.0], [0.0, 0.0, 0.6, 0.8])
ORIGIN = pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def start_pose(pose: Transform) -> PoseWithCovarianceStamped:
    message = PoseWithCovarianceStamped()  # without a stamp it holds at the next pair
    message.pose.pose = pose_msg(pose, pose.file_quat_xyzw)
    return message


def test_wheel_odometry_tells_where_to_look(ros: None, capfd: Capture) -> None:
    prior = OdometryBuffer()
    localiser = Localiser(LOC_RIG, LocalisationConfig(), Transform.identity())
    with (
        Manager() as peer,
        LocalNode(peer, capfd, LocalisationNode, *MOUNT, *params("motion_prior.wait_s:=0.5")) as node,
    ):
        send_infos(peer, "loc", LOC_RIG)
        # the subscription takes best effort: what is sent before it knows the publisher does not come
        early = bag_messages.odometry(loc_pair(0).stamp_ns - 10**10, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        early.child_frame_id = "rb"
        peer.publish(Odometry, "motion_prior", raw(early))
        peer.spin(0.5)
        expected, sent = [], 0
        # in a frame of its own; before, at and after the stamp of the pair
        for before, index, ahead in ((0, 0, 0), (0, 1, 0), (1, 2, -1), (2, 6, 1)):
            pair = loc_pair(index)
            for moment in range(sent, index + 1 + ahead):
                pose, stamp_ns = OTHER_FRAME @ true_pose(moment), loc_pair(moment).stamp_ns
                message = bag_messages.odometry(stamp_ns, pose.translation, pose.quat_xyzw)
                message.child_frame_id = "rb"
                prior.add(stamp_ns, Transform.from_quat(pose.translation, pose.quat_xyzw))
                peer.publish(Odometry, "motion_prior", raw(message), arrival=True)
                sent += 1
            motion = prior.between(loc_pair(before).stamp_ns, pair.stamp_ns, 0.0) if index else None
            expected.append(tuple(localiser.process(pair, motion).T_ds_rb.translation))
            peer.play(index)
        assert peer.positions() == expected
        peer.until(lambda: len(peer.calls) == 4, "the calls")
        used = ["motion_prior" in decode_call(message.data, Task.LOCALISATION).statistics for message in peer.calls]
        assert used == [False, True, False, True]
        peer.publish(Odometry, "motion_prior", Odometry(child_frame_id="camera"))
        node.wait_for("motion_prior is in frame 'camera': frame 'rb' (parameter rb_frame) is required; ignored")


def test_wheel_odometry_of_another_clock_is_reported_as_unused(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT) as node:
        send_infos(peer, "loc", LOC_RIG)
        message = bag_messages.odometry(START_NS + 50 * 10**9, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        message.child_frame_id = "rb"
        peer.play(0)
        peer.publish(Odometry, "motion_prior", raw(message), arrival=True)
        peer.until(lambda: node.node._priors_received, "the odometry")
        peer.play(1)
        node.node.report_periodically()
        node.wait_for("motion_prior is received but not used: its stamps differ by 49.9 s")


def test_two_rovers_in_two_namespaces_do_not_hear_each_other(ros: None, capfd: Capture) -> None:
    one, two = (["-r", f"__ns:=/rover{number}"] for number in (1, 2))
    arguments = ["--params-file", str(CONFIG / "rep105.yaml"), *MOUNT]
    with (
        Peer() as peer,
        LocalNode(peer, capfd, LocalisationNode, *arguments, *one, *params("frame_prefix:=rover1/")),
        LocalNode(peer, capfd, LocalisationNode, *arguments, *two, *params("frame_prefix:=rover2/")),
    ):
        odometry = [peer.listen(Odometry, f"/rover{number}/localisation/odometry") for number in (1, 2)]
        for number in (1, 2):
            send_infos(peer, "loc", LOC_RIG, f"/rover{number}/")
        for number, index in ((1, 0), (2, 10), (1, 1), (2, 11), (1, 2), (2, 12), (1, 3)):
            send_pair(peer, "loc", loc_pair(index), f"/rover{number}/")
        peer.until(lambda: [len(found) for found in odometry] == [4, 3], "all odometry")
        positions = [[odometry_row(message)[1] for message in found] for found in odometry]
        assert positions == [localised([0, 1, 2, 3]), localised([10, 11, 12])]
        for number, found in enumerate(odometry, 1):
            frames = {(m.header.frame_id, m.child_frame_id) for m in found}
            assert frames == {(f"rover{number}/odom", f"rover{number}/base_link")}


@pytest.mark.slow
def test_health_and_latency_say_what_is_wrong_and_when_it_is_over(ros: None, capfd: Capture) -> None:
    arguments = params("health.stale_after_s:=0.6", "health.window_s:=0.6", "health.period_s:=0.1")
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *arguments):
        peer.well(Level.STALE, "no input for more than 0.6 s")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)  # of the year 2023: its stamp says nothing of latency
        assert "latency_stamp_to_publish_s" not in peer.last_values()
        peer.well(Level.WARN, "initialising")
        shift = time.time_ns() - loc_pair(3).stamp_ns  # the clock is set: three pairs have to agree
        for index in (1, 2):
            pair = loc_pair(index)
            send_pair(peer, "loc", replace(pair, stamp_ns=pair.stamp_ns + shift))
        peer.play(3, shift)
        last = {k: float(v) for k, v in peer.last_values().items() if k.endswith("_s")}
        assert 0.0 < last["latency_transport_s"] < 1.0
        assert last["processing_time_s"] <= last["latency_receive_to_publish_s"]
        assert last["latency_receive_to_publish_s"] <= last["latency_stamp_to_publish_s"] + 1e-3 < 5.0
        values = values_of(peer.well(Level.OK, "tracking"))
        assert float(values["processed_hz"]) > 0
        assert int(values["resident_memory_bytes"]) > 50e6
        black = np.zeros((LOC_RIG.height, LOC_RIG.width), np.uint8)
        send_pair(peer, "loc", StereoPair(loc_pair(4).stamp_ns + shift, black, black))
        peer.well(Level.ERROR, "lost")
        peer.play(5, shift)
        peer.well(Level.OK, "tracking")
        peer.well(Level.STALE)


def test_a_clock_that_goes_back_begins_a_new_run(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *params("use_sim_time:=true")) as node:

        def tick(stamp_ns: int) -> None:
            peer.publish(Clock, "/clock", Clock(clock=header_msg(stamp_ns, "").stamp), arrival=True)
            peer.spin(0.1)

        begin = loc_pair(0).stamp_ns
        send_infos(peer, "loc", LOC_RIG)
        for index in (0, 10, 20):
            tick(begin + index * PERIOD_NS)
            peer.play(index)
        assert peer.play(30) != pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
        tick(begin)
        node.wait_for("the clock was set back: localisation restarts at its first pose")
        assert peer.play(0) == ORIGIN
        assert "the stamps have jumped" not in node.text  # once is enough
        assert float(peer.last_values()["latency_stamp_to_publish_s"]) < 60.0  # by the simulated clock


def test_raw_images_are_rectified_and_tracks_and_debug_image_show_what_was_found(
    ros: None, capfd: Capture, tmp_path: Path
) -> None:
    """All is that of the localiser with images rectified offline."""
    infos = [bag_messages.camera_info(START_NS, LOC_RIG, "loc", side) for side in SIDES]
    for side_info in infos:
        side_info.d[:] = (-0.1, 0.02, 0.001, -0.001, 0.0)
    _, rectifier = rig_of_infos(infos, "loc", raw=True)
    mask, path = np.full((LOC_RIG.height, LOC_RIG.width), 255, np.uint8), tmp_path / "mask.png"
    mask[-24:] = 0
    path.write_bytes(encode_png(mask))
    localiser = Localiser(LOC_RIG, LocalisationConfig(left_mask=str(path)), Transform.identity())
    arguments = params("input.rectify:=true", f"localisation.left_mask:={path}")
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *arguments):
        images = peer.listen(Image, "localisation/debug_image")
        tracks = peer.listen(PointCloud2, "localisation/tracks")
        for side, side_info in zip(SIDES, infos, strict=True):
            peer.publish(CameraInfo, f"loc/{side}/camera_info", raw(side_info))
        for index in range(3):
            pair = loc_pair(index)
            for side, pixels in zip(SIDES, (pair.left, pair.right), strict=True):
                message = raw(bag_messages.image(pair.stamp_ns, pixels, "loc", side))
                peer.publish(Image, f"loc/{side}/image_raw", message)
            found = (peer.odometry, images, tracks)
            peer.until(lambda count=index, found=found: min(map(len, found)) > count, "all messages")
            pair = StereoPair(pair.stamp_ns, *rectifier.rectify(pair.left, pair.right))
            estimate = localiser.process(pair)
            assert peer.positions()[-1] == tuple(estimate.T_ds_rb.translation)
            drawn, sent = draw_tracks(pair.left, estimate), images[-1]
            assert (sent.encoding, sent.step, stamp_of(sent)) == ("bgr8", 3 * sent.width, pair.stamp_ns)
            assert sent.header.frame_id == infos[0].header.frame_id != ""
            assert np.array_equal(np.frombuffer(sent.data, np.uint8).reshape(drawn.shape), drawn)
            assert stamp_of(tracks[-1]) == pair.stamp_ns
            rows, shown = tracks_from_msg(tracks[-1]), estimate.tracks
            assert (shown is None) == (index == 0)
            if shown is not None:
                np.testing.assert_array_equal(rows[:, :2], shown.uv.astype(np.float32))
                assert int((rows[:, 4] < 1.0).sum()) == estimate.statistics.inliers > 20


def test_namespace_remapping_and_a_parameter_file_reach_the_node_and_its_results_are_the_localisers(
    ros: None, capfd: Capture, tmp_path: Path
) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(
        "/**/localisation_node:\n  ros__parameters:\n    ds_frame: world\n    rb_frame: rover\n"
        "    localisation:\n      max_features: 300\n",
        encoding="utf-8",
    )
    arguments = ["--params-file", str(file), "-r", "__ns:=/rover1", *MOUNT]
    arguments += ["-r", "loc/left/image_rect:=/cam/l", "-r", "initialpose:=/start"]
    with Peer() as peer, LocalNode(peer, capfd, LocalisationNode, *arguments) as node:
        odometry = peer.listen(Odometry, "/rover1/localisation/odometry")
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        (line,) = [line for line in node.text.splitlines() if "subscribes to" in line]
        for name in ("/start", "/cam/l", "/rover1/loc/right/camera_info", "/rover1/localisation/odometry"):
            assert name in line
        first = Transform.from_quat(true_pose(0).translation, true_pose(0).quat_xyzw)
        peer.publish(PoseWithCovarianceStamped, "/start", start_pose(first), arrival=True)
        peer.spin(0.1)
        send_infos(peer, "loc", LOC_RIG, "/rover1/")
        localiser = Localiser(LOC_RIG, LocalisationConfig(max_features=300), first)
        for index in range(4):
            pair = loc_pair(index)
            peer.publish(Image, "/cam/l", raw(bag_messages.image(pair.stamp_ns, pair.left, "loc", "left")))
            right = raw(bag_messages.image(pair.stamp_ns, pair.right, "loc", "right"))
            peer.publish(Image, "/rover1/loc/right/image_rect", right)
            peer.until(lambda index=index: len(odometry) > index and len(calls(diagnostics)) > index, "odometry")
            expected, message = localiser.process(pair), odometry[index]
            place, turn = tuple(expected.T_ds_rb.translation), tuple(expected.T_ds_rb.quat_xyzw)
            assert odometry_row(message) == (pair.stamp_ns, place, turn)
            assert np.array_equal(covariance_of(message), expected.covariance)
            status = calls(diagnostics)[index]
            values = values_of(status)
            assert (status.name, values["state"]) == ("rover1/localisation_node: call", expected.state.value)
            assert int(values["stamp_ns"]) == pair.stamp_ns
            assert float(values["processing_time_s"]) > 0
            assert int(values["peak_rss_bytes"]) > 50e6
        assert (odometry[0].header.frame_id, odometry[0].child_frame_id) == ("world", "rover")
        assert np.linalg.norm(np.array(place) - true_pose(3).translation) < 0.02


def test_localisation_survives_what_the_network_may_send(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT) as node:
        bad = bag_messages.camera_info(START_NS, LOC_RIG, "loc", "left")
        bad.p[0] = 0.0
        peer.publish(CameraInfo, "loc/left/camera_info", raw(bad))
        right_info = raw(bag_messages.camera_info(START_NS, LOC_RIG, "loc", "right"))
        peer.publish(CameraInfo, "loc/right/camera_info", right_info)
        peer.refused("is non-rectified")
        send_infos(peer, "loc", LOC_RIG)
        good = raw(bag_messages.image(START_NS, loc_pair(0).left, "loc", "left"))
        for broken in (good[: len(good) // 2], b"\0\1\0", b"\xff" * 64):
            peer.publish(Image, "loc/left/image_rect", broken)
        huge = Image(header=header_msg(START_NS - PERIOD_NS, ""), height=2**31, width=2**31, step=2**31)
        for side in SIDES:
            peer.publish(Image, f"loc/{side}/image_rect", huge)
        peer.refused("its camera_info states")
        nowhere = PoseWithCovarianceStamped(header=header_msg(0, "ds"))
        nowhere.pose.pose.position.x = math.nan
        peer.publish(PoseWithCovarianceStamped, "initialpose", nowhere)
        assert peer.play(0) == ORIGIN
        assert len(peer.odometry) == 1
        at = peer.play(1)
        ancient = PoseWithCovarianceStamped(header=header_msg(5, "ds"))
        ancient.pose.pose.position.x = 50.0
        peer.publish(PoseWithCovarianceStamped, "initialpose", ancient)
        send_infos(peer, "loc", replace(LOC_RIG, fx=151.0, fy=151.0))
        node.wait_for("camera_info of 'loc' has changed")
        assert peer.play(2) == pytest.approx(at, abs=1e-12)
        node.wait_for("the cameras have changed: localisation restarts at its last pose")
        send_infos(peer, "loc", forged(LOC_RIG, width=65_536, height=65_536, cx=32_767.5, cy=32_767.5))
        peer.refused("camera_info of loc: image is 65536 x 65536: positive whole numbers")
        peer.play(3)  # the rig known stays


def test_localisation_restarts_by_service_by_pose_and_when_stamps_go_back(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT) as node:
        answers = peer.listen(PoseWithCovarianceStamped, "localisation/initialpose_set")
        send_infos(peer, "loc", LOC_RIG)
        assert peer.play(0) == ORIGIN
        peer.play(1)
        message = start_pose(true_pose(1))
        peer.publish(PoseWithCovarianceStamped, "initialpose", message)
        (answer,) = peer.until(lambda: answers, "what was set")
        assert answer.pose.pose == message.pose.pose
        assert peer.play(2) == pytest.approx(true_pose(1).translation, abs=1e-9)
        assert peer.play(3) == pytest.approx(true_pose(2).translation, abs=0.005)
        paths = peer.listen(PathMsg, "localisation/path", latched=True)
        peer.until(lambda: paths, "the path for who comes late")
        assert paths[0].header.frame_id == "ds"
        assert paths[0].poses[0].pose.position.x == pytest.approx(0.0, abs=1e-12)
        shift_ns = -10 * PERIOD_NS - 10**9
        count = len(peer.odometry)
        for index in (0, 1):  # alone these would be strays
            pair = loc_pair(index)
            send_pair(peer, "loc", replace(pair, stamp_ns=pair.stamp_ns + shift_ns))
        peer.play(2, shift_ns)
        peer.until(lambda: len(peer.odometry) == count + 3, "the poses of the new run")
        assert peer.positions()[count] == pytest.approx(true_pose(1).translation, abs=1e-9)
        assert "the stamps have jumped" in node.text
        assert peer.call("localisation_node/reset").success
        assert peer.play(5) == ORIGIN


@pytest.mark.parametrize("unknown", [0.0, 1e6], ids=["the pose tool of RViz", "a filter on a plane"])
def test_a_pose_set_on_a_plane_keeps_height_and_tilt_on_a_slope(ros: None, capfd: Capture, unknown: float) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT):
        answers = peer.listen(PoseWithCovarianceStamped, "localisation/initialpose_set")
        send_infos(peer, "loc", LOC_RIG)
        slope = Transform(matrix_from_rotvec([0.08, 0.14, 0.0]), np.array([1.0, 2.0, 3.0]))
        peer.publish(PoseWithCovarianceStamped, "initialpose", start_pose(slope))
        peer.until(lambda: answers, "the slope")
        peer.play(0)
        tool = start_pose(Transform(matrix_from_rotvec([0.0, 0.0, 0.7]), np.array([5.0, 6.0, 0.0])))
        for place, variance in {0: 0.25, 7: 0.25, 35: 0.07, 14: unknown, 21: unknown, 28: unknown}.items():
            tool.pose.covariance[place] = variance
        peer.publish(PoseWithCovarianceStamped, "initialpose", tool)
        peer.until(lambda: len(answers) == 2, "the pose on the plane")
        assert peer.play(1) == pytest.approx((5.0, 6.0, 3.0), abs=1e-9)
        turned = transform_from_pose(peer.odometry[-1].pose.pose, "odometry").rotation
        np.testing.assert_allclose(turned[2], slope.rotation[2], atol=1e-9)  # the vertical in RB: roll and pitch
        assert np.arctan2(turned[1, 0], turned[0, 0]) == pytest.approx(0.7, abs=1e-9)


@pytest.mark.parametrize("stray", ["old", "unstamped", "both", "of tomorrow", "of the camera_info"])
def test_stray_pairs_are_dropped_and_counted_and_the_pose_goes_on(ros: None, capfd: Capture, stray: str) -> None:
    """As of a driver that flushes a buffer, or stamps some images with 0."""
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT) as node:
        send_infos(peer, "loc", LOC_RIG)
        stamps = {"old": [-30 * PERIOD_NS], "unstamped": [-loc_pair(1).stamp_ns], "both": [0, -30 * PERIOD_NS]}
        stamps |= {"of tomorrow": [86_400 * 10**9]}
        for index in range(3):
            peer.play(index)
            for shift_ns in stamps.get(stray, ()):
                pair = loc_pair(index)
                send_pair(peer, "loc", replace(pair, stamp_ns=max(pair.stamp_ns + shift_ns, 0)))
            if "camera_info" in stray:
                send_infos(peer, "loc", LOC_RIG, stamp_ns=0 if index % 2 else START_NS - 10**12)
        peer.play(3)
        assert peer.positions() == localised([0, 1, 2, 3])
        values = peer.last_values()
        dropped = sum(int(values[f"dropped_{name}"]) for name in ("stray", "stale", "unpaired"))
        assert dropped >= 3 or "camera_info" in stray
        assert "localisation restarts" not in node.text


def test_a_node_that_waits_names_the_topics_that_it_was_given(ros: None, capfd: Capture) -> None:
    remaps = [f"loc/{side}/image_rect/compressed:=/eye/{side}/compressed" for side in SIDES]
    arguments = [word for rule in remaps for word in ("-r", rule)]
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *arguments) as node:
        node.node.report_periodically()
        assert "/eye/left/compressed, /loc/left/camera_info, /eye/right/compressed" in node.text
        assert "/loc/left/image_rect" not in node.text.partition("Waiting for")[2]


@pytest.mark.parametrize(
    ("namespace", "published", "words"),
    [
        ("/rover", "/loc/left/image_rect", "without its namespace"),
        ("/", "/loc/left/image_raw", "input.rectify to true"),
        ("/", "/loc/left/image_raw/compressed", "input.rectify to true"),
    ],
)
def test_a_node_that_waits_names_a_similar_topic(
    ros: None, capfd: Capture, namespace: str, published: str, words: str
) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, "-r", f"__ns:={namespace}") as node:
        peer.node.create_publisher(CompressedImage if "compressed" in published else Image, published, 1)
        peer.until(lambda: words in node.node.waits_for(), words)


@pytest.mark.parametrize("topic", ["image_rect", "camera_info"])
def test_one_topic_for_both_cameras_is_refused(ros: None, topic: str) -> None:
    rule = f"loc/right/{topic}:=/loc/left/{topic}"
    node = LocalisationNode(cli_args=["--ros-args", *MOUNT, "-r", rule], use_global_arguments=False)
    with pytest.raises(ConfigError, match="both remapped"):
        node.start()
    node.destroy_node()


def test_a_camera_info_that_was_published_once_is_received(ros: None, capfd: Capture) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with Manager() as peer:
        infos = [peer.node.create_publisher(CameraInfo, f"loc/{side}/camera_info", latched) for side in SIDES]
        for side, publisher in zip(SIDES, infos, strict=True):
            publisher.publish(raw(bag_messages.camera_info(START_NS, LOC_RIG, "loc", side)))
        with LocalNode(peer, capfd, LocalisationNode, *MOUNT):
            peer.play(0)
            peer.play(1)
        assert peer.positions() == localised([0, 1])


def test_camera_info_that_describes_no_rig_is_reported_by_its_fault(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT) as node:
        for changes, words in (
            ({"width": 0, "height": 0}, "has no image size"),
            ({"p": np.zeros(12)}, "has no projection matrix p"),
            ({"p": bag_messages.camera_info(START_NS, LOC_RIG, "loc", "left").p}, "calibrate both cameras as a pair"),
        ):
            for side in ("left", "right"):
                message = bag_messages.camera_info(START_NS, LOC_RIG, "loc", side)
                peer.publish(CameraInfo, f"loc/{side}/camera_info", raw(replace(message, **changes)))
            peer.refused(words)
        send_infos(peer, "loc", replace(LOC_RIG, baseline_m=4.0))
        node.wait_for("the baseline of the cameras 'loc' is 4 m")


def test_compressed_images_follow_the_remapping_of_the_raw_images(ros: None, capfd: Capture) -> None:
    rule = ["-r", "loc/left/image_rect:=/zed/left/image_rect_color"]
    swap = ["-r", "loc/right/image_rect:=/b", "-r", "loc/right/image_rect/compressed:=/c", "-r", "/b/compressed:=/d"]
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *rule, *swap) as node:
        topics = {item.topic_name for item in node.node.subscriptions}
        assert {"/zed/left/image_rect_color", "/zed/left/image_rect_color/compressed", "/b", "/c"} <= topics


def test_two_publishers_of_an_image_are_named_and_not_taken_for_losses(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *params("health.period_s:=0.1")) as node:
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        other = peer.node.create_publisher(Image, "loc/left/image_rect", 10)
        peer.until(lambda: peer.node.count_publishers("loc/left/image_rect") == 2, "two publishers")
        node.node.report_periodically()
        peer.well(Level.WARN, "loc/left/image_rect has 2 publishers (/peer, /peer): stop all but one")
        (images,) = (item for item in node.node.subscriptions if item.topic_name == "/loc/left/image_rect")
        for number in range(1, 100, 2):
            images.callback(Image(), {"publication_sequence_number": number})
        assert "lost in transport" not in node.text
        peer.node.destroy_publisher(other)


def test_a_camera_info_that_differs_in_its_last_bits_is_the_same_camera(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT) as node:
        for index in range(4):
            send_infos(
                peer, "loc", replace(LOC_RIG, fx=LOC_RIG.fx * (1.0 + 1e-7 * index), cy=LOC_RIG.cy + 1e-4 * index)
            )
            peer.play(index)
        assert "has changed" not in node.text
        assert peer.positions()[-1] == pytest.approx(localised([0, 1, 2, 3])[-1], abs=1e-4)


@pytest.mark.parametrize("shift_px", [0.0, 5.5])
def test_p_alone_describes_rectified_images(ros: None, capfd: Capture, shift_px: float) -> None:
    """image_proc publishes image_rect beside the camera_info of the raw camera; P of left and right may differ."""
    infos = [bag_messages.camera_info(START_NS, LOC_RIG, "loc", side) for side in SIDES]
    for info in infos:
        info.d[:] = (-0.1, 0.02, 0.001, -0.001, 0.0)
        info.k[:] *= 1.03
    infos[1].p[2] += shift_px
    rig, rectifier = rig_of_infos(infos, "loc", raw=False)
    localiser = Localiser(replace(rig, T_rb_sb=LOC_RIG.T_rb_sb), LocalisationConfig(), Transform.identity())
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT):
        for side, info in zip(SIDES, infos, strict=True):
            peer.publish(CameraInfo, f"loc/{side}/camera_info", raw(info))
        for index in range(3):
            peer.play(index)
            pair = loc_pair(index)
            if rectifier is not None:
                pair = StereoPair(pair.stamp_ns, *rectifier.rectify(pair.left, pair.right))
            assert peer.positions()[-1] == tuple(localiser.process(pair).T_ds_rb.translation)
    assert (rectifier is None) == (shift_px == 0.0)


def test_compressed_images_that_cannot_be_decoded_are_reported_once_and_the_next_ones_are_taken(
    ros: None, capfd: Capture
) -> None:
    arguments = params("input.image_transport:=compressed")
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT, *arguments) as node:
        send_infos(peer, "loc", LOC_RIG)
        stamps = iter(range(START_NS - 100 * PERIOD_NS, START_NS, PERIOD_NS))
        for kind, topic, message in malformed_messages.compressed_images("loc", loc_pair(0), lambda: next(stamps)):
            peer.publish(kind, topic, message)
        peer.refused("its camera_info states")
        node.node.report_periodically()
        assert "Waiting for" not in node.text, "images are received: their own reason was reported"
        pair = loc_pair(0)
        for side, pixels in zip(SIDES, (pair.left, pair.right), strict=True):
            message = CompressedImage(header=header_msg(pair.stamp_ns, ""), format="png", data=encode_png(pixels))
            peer.publish(CompressedImage, f"loc/{side}/image_rect/compressed", message)
        peer.until(lambda: peer.odometry, "the pose of valid images")


def test_raw_images_are_taken_alone_where_both_transports_are_offered(ros: None, capfd: Capture) -> None:
    with Manager() as peer, LocalNode(peer, capfd, LocalisationNode, *MOUNT):
        compressed = [peer.node.create_publisher(CompressedImage, f"loc/{s}/image_rect/compressed", 5) for s in SIDES]
        peer.until(lambda: all(item.get_subscription_count() for item in compressed), "subscriptions to both")
        send_infos(peer, "loc", LOC_RIG)
        peer.play(0)
        peer.until(lambda: not any(item.get_subscription_count() for item in compressed), "raw alone")


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("T_rb_locsb.quat_xyzw:=[0.0, 0.0, 0.0, 2.0]", "a unit quaternion is required"),
        ("frame_prefix:=/rover1/", "'/rover1/ds' is not a frame name"),
        ("rb_frame:=ds", "different names are required"),
        ("localisation.max_feature:=3", "unknown key 'localisation.max_feature'"),
        ("input.image_transport:=theora", "one of raw, compressed, auto is required"),
        ("use_sim_time:=1", "'use_sim_time' is 1: true or false is required"),  # ROS would ignore it
    ],
)
def test_parameters_that_are_not_valid_are_named(ros: None, argument: str, words: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(words)):
        LocalisationNode(cli_args=["--ros-args", *params(argument)], use_global_arguments=False)
