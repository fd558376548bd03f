"""Topics of drivers as they publish them, and what they are taken for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.io.truth.names import is_own
from sfr_loc_map.source_setup.seen_topics import SeenTopic
from sfr_loc_map.source_setup.topic_guess import Guess, guess_topics

KINDS = {
    "Image": "sensor_msgs/msg/Image",
    "Jpeg": "sensor_msgs/msg/CompressedImage",
    "Info": "sensor_msgs/msg/CameraInfo",
    "Points": "sensor_msgs/msg/PointCloud2",
    "Joints": "sensor_msgs/msg/JointState",
    "Fix": "sensor_msgs/msg/NavSatFix",
    "Imu": "sensor_msgs/msg/Imu",
    "Odom": "nav_msgs/msg/Odometry",
    "Path": "nav_msgs/msg/Path",
    "Pose": "geometry_msgs/msg/PoseStamped",
    "PoseCov": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "Transform": "geometry_msgs/msg/TransformStamped",
    "Point": "geometry_msgs/msg/PointStamped",
    "Disparity": "stereo_msgs/msg/DisparityImage",
    "Tf": "tf2_msgs/msg/TFMessage",
}


def seen(text: str) -> list[SeenTopic]:
    """Return topics of lines `KIND [COUNT] [WIDTHxHEIGHT] [@FRAME] NAME...`; names may hold {left,right}."""
    topics = []
    for line in text.strip().splitlines():
        kind, *rest = line.split()
        count, size, frame = 100, (0, 0), ""
        for word in rest:
            if word.isdigit():
                count = int(word)
            elif word.startswith("@"):
                frame = word[1:]
            elif word[0].isdigit():
                width, _, height = word.partition("x")
                size = (int(width), int(height))
            else:
                before, brace, after = word.partition("{")
                choices, _, after = after.partition("}")
                for choice in choices.split(",") if brace else [""]:
                    topics.append(
                        SeenTopic(before + choice + after, KINDS[kind], count, frame.replace("{}", choice), size)
                    )
    return topics


@dataclass(frozen=True)
class Case:
    """Topics of a recording, what images and camera_info of both tasks are to be, and the truth."""

    topics: str
    images: str = ""  #: of localisation, with {left,right}; `raw` in front where they are not rectified
    info: str = ""
    nav: str = ""
    truth: str = ""
    layout: str = ""
    others: tuple[tuple[str, str], ...] = ()
    remark: str = ""


CASES = {
    "zed, wrapper 5": Case(
        """
        Image 1280x720 @zed_{}_camera_frame_optical /zed/zed_node/{left,right}/color/rect/image
        Image 1280x720 @zed_{}_camera_frame_optical /zed/zed_node/{left,right}/color/raw/image
        Image 1280x720 @zed_{}_camera_frame_optical /zed/zed_node/{left,right}/gray/raw/image
        Jpeg 1280x720 @zed_{}_camera_frame_optical /zed/zed_node/{left,right}/color/rect/image/compressed
        Info 1280x720 /zed/zed_node/left/color/rect/camera_info /zed/zed_node/right/color/rect/camera_info
        Info 1280x720 /zed/zed_node/left/color/raw/camera_info /zed/zed_node/right/color/raw/camera_info
        Image 1280x720 @zed_left_camera_frame_optical /zed/zed_node/rgb/color/rect/image
        Info 1280x720 /zed/zed_node/rgb/color/rect/camera_info /zed/zed_node/depth/camera_info
        Image 1280x720 @zed_left_camera_frame_optical /zed/zed_node/depth/depth_registered
        Image 1280x720 @zed_left_camera_frame_optical /zed/zed_node/confidence/confidence_map
        Image 2560x720 @zed_left_camera_frame_optical /zed/zed_node/stereo/color/rect/image
        Points /zed/zed_node/point_cloud/cloud_registered
        Odom /zed/zed_node/odom
        Pose /zed/zed_node/pose
        PoseCov /zed/zed_node/pose_with_covariance
        Path /zed/zed_node/path_map /zed/zed_node/path_odom
        Joints /zed/joint_states
        """,
        "/zed/zed_node/{}/color/rect/image",
        "/zed/zed_node/{}/color/rect/camera_info",
    ),
    "zed 2i, wrapper 4": Case(
        """
        Image 1104x621 @zed2i_{}_camera_optical_frame /zed2i/zed_node/{left,right}/image_rect_color
        Image 1104x621 @zed2i_{}_camera_optical_frame /zed2i/zed_node/{left,right}_gray/image_rect_gray
        Image 1104x621 @zed2i_{}_camera_optical_frame /zed2i/zed_node/{left,right}_raw/image_raw_color
        Info 1104x621 /zed2i/zed_node/{left,right}/camera_info /zed2i/zed_node/{left,right}_raw/camera_info
        Info 1104x621 /zed2i/zed_node/{left,right}_gray/camera_info /zed2i/zed_node/rgb/camera_info
        Image 1104x621 @zed2i_left_camera_optical_frame /zed2i/zed_node/rgb/image_rect_color
        Image 2208x621 @zed2i_left_camera_optical_frame /zed2i/zed_node/stereo/image_rect_color
        Disparity /zed2i/zed_node/disparity/disparity_image
        Odom /zed2i/zed_node/odom
        Pose /zed2i/zed_node/pose /vrpn_mocap/rover/pose
        Fix /zed2i/zed_node/pose/fused_fix /zed2i/zed_node/pose/origin_fix
        """,
        "/zed2i/zed_node/{}_gray/image_rect_gray",
        "/zed2i/zed_node/{}_gray/camera_info",
        truth="/vrpn_mocap/rover/pose",
    ),
    "realsense d455": Case(
        """
        Image 848x480 @camera_infra{}_optical_frame /camera/camera/infra{1,2}/image_rect_raw
        Jpeg 848x480 @camera_infra{}_optical_frame /camera/camera/infra{1,2}/image_rect_raw/compressed
        Jpeg 848x480 @camera_infra{}_optical_frame /camera/camera/infra{1,2}/image_rect_raw/compressedDepth
        Info 848x480 /camera/camera/infra{1,2}/camera_info /camera/camera/color/camera_info
        Info 848x480 /camera/camera/depth/camera_info /camera/camera/aligned_depth_to_infra{1,2}/camera_info
        Image 848x480 @camera_infra1_optical_frame /camera/camera/aligned_depth_to_infra{1,2}/image_raw
        Image 848x480 @camera_depth_optical_frame /camera/camera/depth/image_rect_raw
        Image 848x480 @camera_color_optical_frame /camera/camera/color/image_raw
        Imu /camera/camera/imu
        Fix /fix
        """,
        "/camera/camera/infra{1,2}/image_rect_raw",
        "/camera/camera/infra{1,2}/camera_info",
        truth="/fix",
        remark="emitter",
    ),
    "two realsense cameras, one on the mast": Case(
        """
        Image 640x480 @mast_infra{}_optical_frame /mast_camera/infra{1,2}/image_rect_raw
        Info 640x480 /mast_camera/infra{1,2}/camera_info
        Image 640x480 @body_infra{}_optical_frame /body_camera/infra{1,2}/image_rect_raw
        Info 640x480 /body_camera/infra{1,2}/camera_info
        Joints /joint_states
        """,
        "/body_camera/infra{1,2}/image_rect_raw",
        "/body_camera/infra{1,2}/camera_info",
        nav="/mast_camera/infra{1,2}/image_rect_raw",
        others=(("joint_states", "/joint_states"),),
        remark="emitter",
    ),
    "realsense, bag of the viewer": Case(
        """
        Image 848x480 /device_0/sensor_0/Infrared_{1,2}/image/data
        Info 1 848x480 /device_0/sensor_0/Infrared_{1,2}/info/camera_info
        Image 848x480 /device_0/sensor_0/Depth_0/image/data /device_0/sensor_1/Color_0/image/data
        Info 1 848x480 /device_0/sensor_0/Depth_0/info/camera_info /device_0/sensor_1/Color_0/info/camera_info
        Imu /device_0/sensor_2/Accel_0/imu/data
        """,
        "raw /device_0/sensor_0/Infrared_{1,2}/image/data",
        "/device_0/sensor_0/Infrared_{1,2}/info/camera_info",
        remark="emitter",
    ),
    "realsense t265": Case(
        """
        Image 848x800 @camera_fisheye{}_optical_frame /camera/fisheye{1,2}/image_raw
        Info 848x800 /camera/fisheye{1,2}/camera_info
        Odom /camera/odom/sample
        """,
        "raw /camera/fisheye{1,2}/image_raw",
        "/camera/fisheye{1,2}/camera_info",
    ),
    "oak-d": Case(
        """
        Image 640x400 @oak_{}_camera_optical_frame /oak/{left,right}/image_rect
        Image 640x400 @oak_{}_camera_optical_frame /oak/{left,right}/image_raw
        Jpeg 640x400 @oak_{}_camera_optical_frame /oak/{left,right}/image_raw/compressed
        Info 640x400 /oak/{left,right}/camera_info
        Image 640x400 @oak_right_camera_optical_frame /oak/stereo/image_raw
        Info 640x400 /oak/stereo/camera_info
        Image 1280x720 @oak_rgb_camera_optical_frame /oak/rgb/image_raw /oak/rgb/image_rect
        Info 1280x720 /oak/rgb/camera_info
        Joints /joint_states
        """,
        "/oak/{}/image_rect",
        "/oak/{}/camera_info",
    ),
    "usb_cam, two by number": Case(
        """
        Image 98 640x480 @camera1 /camera1/image_raw
        Image 640x480 @camera2 /camera2/image_raw
        Jpeg 640x480 /camera{1,2}/image_raw/compressed
        Jpeg 640x480 /camera{1,2}/image_raw/compressedDepth
        Info 640x480 /camera{1,2}/camera_info
        """,
        "raw /camera{1,2}/image_raw",
        "/camera{1,2}/camera_info",
    ),
    "usb_cam, one image of both": Case(
        """
        Image 1344x376 @usb_cam /usb_cam/image_raw
        Jpeg 1344x376 @usb_cam /usb_cam/image_raw/compressed
        Info 1344x376 /usb_cam/camera_info
        """,
        "raw /usb_cam/image_raw",
        layout="side_by_side",
    ),
    "one above the other": Case(
        "Jpeg 1280x1440 /stereo/image_raw/compressed", "raw /stereo/image_raw/compressed", layout="top_bottom"
    ),
    "one wide camera alone": Case(
        "Image 1241x376 /camera/image_raw\nInfo 1241x376 /camera/camera_info", remark="1241 x 376"
    ),
    "one wide camera alone, of an even width": Case("Image 1242x376 /camera/image_raw", remark="1242 x 376"),
    "one camera alone": Case("Image 1280x720 /camera/image_raw\nInfo 1280x720 /camera/camera_info"),
    "camera_ros, two nodes": Case(
        """
        Image 800x600 @camera /left_camera/left_image_raw /right_camera/right_image_raw
        Info 800x600 /left_camera/camera_info /right_camera/camera_info
        """,
        "raw /{}_camera/{}_image_raw",
        "/{}_camera/camera_info",
    ),
    "isaac nova, four hawks": Case(
        """
        Image 1920x1200 @front_stereo_camera_{}_optical /front_stereo_camera/{left,right}/image_raw
        Image 1920x1200 @front_stereo_camera_{}_optical /front_stereo_camera/{left,right}/image_rect
        Image 960x600 @front_stereo_camera_{}_optical /front_stereo_camera/{left,right}/image_resized
        Info 1920x1200 /front_stereo_camera/{left,right}/camera_info /front_stereo_camera/{left,right}/camera_info_rect
        Info 960x600 /front_stereo_camera/{left,right}/camera_info_resized
        Image 1920x1200 @back_stereo_camera_{}_optical /back_stereo_camera/{left,right}/image_raw
        Image 1920x1200 @left_stereo_camera_{}_optical /left_stereo_camera/{left,right}/image_raw
        Image 1920x1200 @right_stereo_camera_{}_optical /right_stereo_camera/{left,right}/image_raw
        Info 1920x1200 /back_stereo_camera/{left,right}/camera_info /left_stereo_camera/{left,right}/camera_info
        Info 1920x1200 /right_stereo_camera/{left,right}/camera_info
        Odom /chassis/odom /visual_slam/tracking/odometry
        """,
        "/front_stereo_camera/{}/image_rect",
        "/front_stereo_camera/{}/camera_info_rect",
        remark="back_stereo_camera",
    ),
    "stereo_image_proc": Case(
        """
        Image 1024x768 @stereo_left /stereo/left/image_raw /stereo/right/image_raw
        Image 1024x768 @stereo_left /stereo/{left,right}/image_mono /stereo/{left,right}/image_color
        Image 1024x768 @stereo_left /stereo/{left,right}/image_rect /stereo/{left,right}/image_rect_color
        Info 1024x768 /stereo/{left,right}/camera_info
        Disparity /stereo/disparity
        Points /stereo/points2
        Odom /odometry/filtered /ground_truth/state
        """,
        "/stereo/{}/image_rect",
        "/stereo/{}/camera_info",
        truth="/ground_truth/state",
    ),
    "orbbec gemini": Case(
        """
        Image 848x480 @camera_{}_ir_optical_frame /camera/{left,right}_ir/image_raw
        Jpeg 848x480 @camera_{}_ir_optical_frame /camera/{left,right}_ir/image_raw/compressed
        Info 848x480 /camera/{left,right}_ir/camera_info /camera/color/camera_info /camera/depth/camera_info
        Image 848x480 @camera_depth_optical_frame /camera/depth/image_raw
        Image 1280x720 @camera_color_optical_frame /camera/color/image_raw
        Points /camera/depth/points
        """,
        "raw /camera/{}_ir/image_raw",
        "/camera/{}_ir/camera_info",
    ),
    "mynt eye": Case(
        """
        Image 752x480 @mynteye_{}_frame /mynteye/{left,right}/image_raw
        Image 752x480 @mynteye_{}_rect_frame /mynteye/{left,right}_rect/image_rect
        Info 752x480 /mynteye/{left,right}/camera_info /mynteye/{left,right}_rect/camera_info
        Image 752x480 /mynteye/depth/image_raw /mynteye/disparity/image_raw
        Transform /vicon/rover/rover
        Tf /tf
        """,
        "/mynteye/{}_rect/image_rect",
        "/mynteye/{}_rect/camera_info",
        truth="/vicon/rover/rover",
    ),
    "duo": Case(
        """
        Image 752x480 @duo3d_camera /duo3d/{left,right}/image_rect
        Image 752x480 @duo3d_camera /duo3d/depth/image_raw
        Info 752x480 /duo3d/{left,right}/camera_info
        """,
        "/duo3d/{}/image_rect",
        "/duo3d/{}/camera_info",
    ),
    "euroc": Case(
        """
        Image 752x480 @cam{} /cam{0,1}/image_raw
        Imu /imu0
        Point /leica/position
        Transform /vicon/firefly_sbx/firefly_sbx
        """,
        "raw /cam{0,1}/image_raw",
        truth="/vicon/firefly_sbx/firefly_sbx",
    ),
    "kitti2bag": Case(
        """
        Image 1242x375 @camera_gray_{} /kitti/camera_gray_{left,right}/image_raw
        Image 1242x375 @camera_color_{} /kitti/camera_color_{left,right}/image_raw
        Info 1242x375 /kitti/camera_gray_{left,right}/camera_info /kitti/camera_color_{left,right}/camera_info
        Fix /kitti/oxts/gps/fix
        """,
        "raw /kitti/camera_gray_{}/image_raw",
        "/kitti/camera_gray_{}/camera_info",
        truth="/kitti/oxts/gps/fix",
        remark="camera_color_left",
    ),
    "side words at the end of names": Case(
        """
        Image 640x480 /stereo/image_{left,right}
        Info 640x480 /stereo/camera_info_{left,right}
        """,
        "raw /stereo/image_{}",
        "/stereo/camera_info_{}",
    ),
    "names in camel case": Case(
        """
        Jpeg 1024x544 /rig/leftCamera/imageRect/compressed /rig/rightCamera/imageRect/compressed
        Info 1024x544 /rig/leftCamera/cameraInfo /rig/rightCamera/cameraInfo
        Image 1024x544 /rig/leftCamera/disparity
        Fix /gps/fix /rtk/fix
        """,
        "/rig/{}Camera/imageRect/compressed",
        "/rig/{}Camera/cameraInfo",
        truth="/rtk/fix",
    ),
    "multisense": Case(
        """
        Image 1024x544 @multisense/left_camera_optical_frame /multisense/{left,right}/image_mono
        Image 1024x544 @multisense/left_camera_optical_frame /multisense/{left,right}/image_rect
        Info 1024x544 /multisense/{left,right}/image_mono/camera_info /multisense/{left,right}/image_rect/camera_info
        Image 1024x544 @multisense/left_camera_optical_frame /multisense/left/image_{color,rect_color}
        Info 1024x544 /multisense/left/image_color/camera_info /multisense/left/image_rect_color/camera_info
        Image 1024x544 @multisense/left_camera_optical_frame /multisense/left/disparity
        Image 1024x544 @multisense/left_camera_optical_frame /multisense/depth /multisense/openni_depth
        Points /multisense/image_points2
        """,
        "/multisense/{}/image_rect",
        "/multisense/{}/image_rect/camera_info",
    ),
    "MRCD, a campus drive with a zed": Case(
        """
        Image 1280x720 /zed_node/{left,right}_raw/image_raw_color
        Info 1280x720 /zed_node/{left,right}_raw/camera_info
        Odom /zed_node/odom /platform/odom /platform/odom/filtered
        Path /zed_node/path_map /zed_node/path_odom /ground_truth
        Fix /rtk_gnss/tcpfix
        Joints /platform/joint_states
        Image 640x480 /rs_front/rs_front/aligned_depth_to_color/image_raw /rs_front/rs_front/color/image_raw
        Info 640x480 /rs_front/rs_front/color/camera_info /rs_front/rs_front/depth/camera_info
        Image 640x480 /rs_front/rs_front/depth/image_rect_raw
        Points /velodyne_points /rs_front/rs_front/depth/color/points
        """,
        "raw /zed_node/{}_raw/image_raw_color",
        "/zed_node/{}_raw/camera_info",
        truth="/ground_truth",
    ),
    "a pair named navcam, and no other": Case(
        """
        Image 640x480 /oslr/navcam/{left,right}/image_raw
        Info 640x480 /oslr/navcam/{left,right}/camera_info
        Points /oslr/navcam/points2
        """,
        "raw /oslr/navcam/{}/image_raw",
        "/oslr/navcam/{}/camera_info",
    ),
    "oak by another node, calibration of the colour camera alone": Case(
        """
        Image 640x400 /oak/stereo/{left,right}/image_raw
        Info 640x400 /oak/depth/camera_info /oak/rgb/camera_info
        Image 640x400 /oak/rgb/image_raw /oak/depth/image_raw
        Fix /RTK/data
        """,
        "raw /oak/stereo/{}/image_raw",
        truth="/RTK/data",
    ),
    "sides in frames alone": Case(
        """
        Image 1280x1024 @rig_left_optical /spinnaker/21187341/image_raw
        Image 1280x1024 @rig_right_optical /spinnaker/21187355/image_raw
        Info 1280x1024 /spinnaker/21187341/camera_info /spinnaker/21187355/camera_info
        """,
        "raw /spinnaker/{21187341,21187355}/image_raw",
        "/spinnaker/{21187341,21187355}/camera_info",
    ),
    "the suite's names, of one rover": Case(
        """
        Image 512x512 /rover/loc/{left,right}/image_rect
        Info 512x512 /rover/loc/{left,right}/camera_info /rover/nav/{left,right}/camera_info
        Jpeg 512x512 /rover/nav/{left,right}/image_rect/compressed
        Pose /rover/nav/pose
        Points /rover/ground_truth/points
        Odom /rover/ground_truth/odometry /rover/localisation/odometry /gt/odom
        Image 512x512 /hazcam/{left,right}/image_rect
        """,
        "/rover/loc/{}/image_rect",
        "/rover/loc/{}/camera_info",
        nav="/rover/nav/{}/image_rect/compressed",
        truth="/rover/ground_truth/odometry",
        others=(("nav/pose", "/rover/nav/pose"), ("ground_truth/points", "/rover/ground_truth/points")),
    ),
    "several bodies in the hall": Case(
        """
        Image 640x480 /stereo/{left,right}/image_rect
        Info 640x480 /stereo/{left,right}/camera_info
        Pose /optitrack/rover/pose /optitrack/wand/pose
        """,
        "/stereo/{}/image_rect",
        "/stereo/{}/camera_info",
        remark="/optitrack/wand/pose",
    ),
}


def both(pattern: str) -> list[str]:
    """Return the names of left and right of a pattern, with {} for left and right or with its own two words."""
    words = pattern.partition("{")[2].partition("}")[0]
    return [pattern.removeprefix("raw ").replace(f"{{{words}}}", w) for w in (words or "left,right").split(",")]


def expected(case: Case) -> dict[str, str]:
    topics = dict(case.others)
    sides = ("left",) if case.layout else ("left", "right")
    for task, pattern in (("loc", case.images), ("nav", case.nav)):
        kind = "image_raw" if pattern.startswith("raw ") else "image_rect"
        topics |= {f"{task}/{side}/{kind}": name for side, name in zip(sides, both(pattern), strict=False) if pattern}
    if case.info:
        topics |= {f"loc/{side}/camera_info": name for side, name in zip(sides, both(case.info), strict=True)}
    return topics


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_topics_of_drivers(case: Case) -> None:
    guess = guess_topics(seen(case.topics))
    found = {name: topic for name, topic in guess.topics.items() if "camera_info" not in name or "nav/" not in name}
    assert (found, guess.layout, guess.truth) == (expected(case), case.layout, case.truth)
    assert guess.reasons.keys() == guess.topics.keys()
    assert bool(guess.truth_reason) == bool(guess.truth)
    assert case.remark in " ".join(guess.remarks)
    assert case.remark or not guess.remarks


NAMES = sorted(CASES)
UNRELATED = seen(
    """
    Imu /imu/data
    Odom /wheel_odom /rtabmap/odom
    Tf /tf /tf_static
    Points /lidar/points
    Image 320x240 /thermal_front/image_raw /camera_info/image
    Image 848x480 /front/depth/image_rect_raw
    Pose /goal_pose /move_base/goal
    Info 320x240 /thermal_front/camera_info
    Path /plan
    """
)


@given(st.sampled_from(NAMES).flatmap(lambda name: st.permutations(seen(CASES[name].topics)).map(lambda t: (name, t))))
def test_the_order_of_topics_does_not_matter(drawn: tuple[str, Sequence[SeenTopic]]) -> None:
    name, topics = drawn
    assert guess_topics(topics) == guess_topics(seen(CASES[name].topics))


@given(st.sampled_from(NAMES), st.sets(st.sampled_from(UNRELATED)))
def test_unrelated_topics_change_nothing(name: str, others: set[SeenTopic]) -> None:
    topics = seen(CASES[name].topics)
    assert guess_topics([*topics, *others]) == guess_topics(topics)


def swapped(text: str) -> str:
    return text.replace("left", "?").replace("right", "left").replace("?", "right")


@pytest.mark.parametrize("name", NAMES)
def test_swapped_sides_swap_the_answer(name: str) -> None:
    topics = seen(CASES[name].topics)
    guess = guess_topics(topics)
    by_words = any("left" in reason for name, reason in guess.reasons.items() if name.startswith("loc/left/image"))
    turned = guess_topics([replace(t, name=swapped(t.name), frame=swapped(t.frame)) for t in topics])
    want = {swapped(name) if by_words else name: swapped(topic) for name, topic in guess.topics.items()}
    assert (turned.topics, turned.truth) == (want, guess.truth)


def test_a_letter_of_a_side_is_replaced_only_where_it_is_a_word() -> None:
    topics = seen("Image 640x480 /oak_l/color_l/image_rect /oak_r/color_r/image_rect")
    found = guess_topics(topics).topics
    assert [found[f"loc/{side}/image_rect"] for side in ("left", "right")] == [topic.name for topic in topics]


def test_a_camera_info_of_the_other_side_is_not_chosen() -> None:
    topics = seen("Image /left/image_raw /right/image_raw\nInfo /left/camera_info_right /right/camera_info")
    found = guess_topics(topics).topics
    assert [topic for name, topic in found.items() if "camera_info" in name] == ["/right/camera_info"]


def test_topics_without_a_message_are_left_out() -> None:
    topics = seen("Image 0 640x480 /a/{left,right}/image_rect\nImage 640x480 /b/{left,right}/image_raw")
    assert both("/b/{}/image_raw") == [t for n, t in guess_topics(topics).topics.items() if "image" in n]


def test_of_two_rovers_none_is_taken() -> None:
    topics = seen("Image /a/loc/{left,right}/image_rect /b/loc/{left,right}/image_rect")
    guess = guess_topics(topics)
    assert isinstance(guess, Guess)
    assert not guess.topics
    assert "/a/" in guess.remarks[0]


def test_wheel_odometry_is_not_named_as_a_truth() -> None:
    assert [*map(is_own, ("/odom", "/wheel/odometry", "/zed/zed_node/pose", "/odometry/filtered"))] == [True] * 4
    assert [*map(is_own, ("/ground_truth/odom", "/rtk/odometry", "/vrpn/rover/pose", "/robot/state"))] == [False] * 4
