"""Bags as other programs write them: truths of trackers with gaps, frames with two parents, mcap of any profile."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from helpers.cli_result import Sfr
from helpers.message_bags import write_messages
from helpers.pose_tables import COUNT, drive
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.files import bag_files
from sfr_loc_map.io.image_codec import samples_of
from sfr_loc_map.io.registry import read_truth
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.io.truth.config import TruthConfig
from sfr_loc_map.metrics.stored.score_json import from_json

T = TYPESTORE.types
STATUS = T["sensor_msgs/msg/NavSatStatus"](0, 1)


def truth_as(place: Path, config: TruthConfig) -> Truth:
    return read_truth(place, SourceConfig(truth=config))


def pose(stamp: int, xyz: Any, quat: Any) -> Any:
    inner = T["geometry_msgs/msg/Pose"](T["geometry_msgs/msg/Point"](*xyz), T["geometry_msgs/msg/Quaternion"](*quat))
    return T["geometry_msgs/msg/PoseStamped"](bag_messages.header(stamp, "map"), inner)


def fix(stamp: int, latitude: float, longitude: float, altitude: float) -> Any:
    head = bag_messages.header(stamp, "gps")
    return T["sensor_msgs/msg/NavSatFix"](head, STATUS, latitude, longitude, altitude, np.zeros(9), 0)


@pytest.mark.parametrize(
    ("wrong", "count"), [("none", 0), ("zeros", 5), ("nan", 2), ("nan altitude", 3), ("latitude of 91 deg", 1)]
)
def test_single_fixes_that_are_none_are_left_out(tmp_path: Path, wrong: str, count: int) -> None:
    values = {"zeros": (0.0, 0.0, 0.0), "nan": (np.nan,) * 3, "latitude of 91 deg": (91.0, 11.0, 500.0)}
    entries = []
    for k, (stamp, xyz) in enumerate(zip(drive().stamps_ns.tolist(), drive().positions.tolist(), strict=True)):
        place = (48.0 + xyz[1] / 111_278.4, 11.0 + xyz[0] / 74_548.9, xyz[2])
        if 3 <= k < 3 + count:
            place = values.get(wrong, (*place[:2], np.nan))
        entries.append(("/fix", stamp, fix(stamp, *place)))
    found = truth_as(write_messages(tmp_path / "x", entries), TruthConfig(source="/fix"))
    assert len(found) == COUNT - count
    assert np.abs(found.positions - found.positions[0]).max() < 15.0


def test_a_first_fix_that_is_a_jump_is_not_the_origin(tmp_path: Path) -> None:
    entries = []
    for k, (stamp, xyz) in enumerate(zip(drive().stamps_ns.tolist(), drive().positions.tolist(), strict=True)):
        place = (48.0 + xyz[1] / 111_278.4, 11.0 + xyz[0] / 74_548.9, 500.0 + xyz[2])
        entries.append(("/fix", stamp, fix(stamp, *(place if k else (-30.0, 150.0, 20.0)))))
    found = truth_as(write_messages(tmp_path / "x", entries), TruthConfig(source="/fix"))
    moved = drive().positions[1:] - drive().positions[1]
    assert np.abs(found.positions - moved).max() < 0.05  # the metres of a degree are rounded


@pytest.mark.parametrize("second", [("world", "rover"), ("map", "drone"), ("/map", "/rover")])
@pytest.mark.parametrize("kind", ["odometry", "transform", "pose"])
def test_poses_of_several_bodies_on_one_topic_are_refused(tmp_path: Path, kind: str, second: tuple[str, str]) -> None:
    entries = []
    for k, (stamp, xyz) in enumerate(zip(drive().stamps_ns.tolist(), drive().positions.tolist(), strict=True)):
        frame, body = ("map", "rover") if k % 2 else second
        if kind == "transform":
            turn = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
            moved = T["geometry_msgs/msg/Transform"](T["geometry_msgs/msg/Vector3"](*xyz), turn)
            message = T["geometry_msgs/msg/TransformStamped"](bag_messages.header(stamp, frame), body, moved)
        elif kind == "odometry":
            message = bag_messages.odometry(stamp, np.array(xyz), np.array([0.0, 0.0, 0.0, 1.0]))
            object.__setattr__(message.header, "frame_id", frame)
            object.__setattr__(message, "child_frame_id", body)
        else:
            message = pose(stamp, xyz, (0.0, 0.0, 0.0, 1.0))
            object.__setattr__(message.header, "frame_id", frame)
        entries.append(("/mocap", stamp, message))
    bag = write_messages(tmp_path / "x", entries)
    has_one_body = second[0].startswith("/") or (kind == "pose" and second[0] == "map")
    if has_one_body:
        assert len(truth_as(bag, TruthConfig(source="/mocap"))) == COUNT
        return
    with pytest.raises(InputError, match=r"'/mocap' of bag .* several bodies or frames"):
        truth_as(bag, TruthConfig(source="/mocap"))


def test_fixes_without_any_altitude_give_horizontal_errors_alone(tmp_path: Path, sfr: Sfr) -> None:
    poses = drive()
    places = np.degrees(poses.positions[:, [1, 0]] / [6_356_752.3**2 / 6_378_137.0, 6_378_137.0])
    entries = [
        ("/fix", stamp, fix(stamp, place[0], 11.0 + place[1], np.nan))
        for stamp, place in zip(poses.stamps_ns.tolist(), places.tolist(), strict=True)
    ]
    place = write_messages(tmp_path / "x", entries)
    found = truth_as(place, TruthConfig(source="/fix"))
    assert (len(found), found.has_height, found.has_attitude) == (COUNT, False, False)
    save_trajectory(tmp_path / "e.csv", poses)
    words = ("score", tmp_path / "e.csv", place, "--set", "truth.source=/fix", "--condition", "distance=2")
    done = sfr(*words, "--lenient", "--json", "-")
    assert done.code == 0, done.err
    assert "the truth has no height: horizontal position errors are judged" in done.err
    score = from_json(done.out, "score")
    assert score.number("position", "mean", condition="distance=2", part="yaw_aligned") is None
    assert score.number("horizontal", "max", condition="distance=2") < 1e-3  # type: ignore[operator]


def test_points_of_a_prism_are_positions(tmp_path: Path) -> None:
    poses = drive()
    entries = [
        ("/leica/position", stamp, T["geometry_msgs/msg/PointStamped"](
            bag_messages.header(stamp, "leica"), T["geometry_msgs/msg/Point"](*xyz)
        ))
        for stamp, xyz in zip(poses.stamps_ns.tolist(), poses.positions.tolist(), strict=True)
    ]  # fmt: skip
    found = truth_as(write_messages(tmp_path / "x", entries), TruthConfig(source="/leica/position"))
    assert not found.has_attitude
    np.testing.assert_array_equal(found.positions, poses.positions)
    assert found.stamps_ns.tolist() == poses.stamps_ns.tolist()


def test_headers_without_stamps_are_read_by_the_times_of_recording(tmp_path: Path, sfr: Sfr) -> None:
    poses = drive()
    entries = [
        ("/gt", stamp, pose(0, xyz, quat))
        for stamp, xyz, quat in zip(poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, strict=True)
    ]
    place = write_messages(tmp_path / "x", entries)
    save_trajectory(tmp_path / "e.csv", poses)
    words = ("score", tmp_path / "e.csv", place, "--condition", "distance=2", "--set", "truth.source=/gt")
    refused = sfr(*words)
    assert refused.code == 2
    assert "truth.stamps=record" in refused.err
    done = sfr(*words, "--set", "truth.stamps=record")
    assert done.code == 0, done.err


@pytest.mark.parametrize("first", ["world", "odom"])
def test_a_frame_in_two_parents_is_followed_in_one(tmp_path: Path, first: str) -> None:
    poses = drive()
    shift = {"world": np.zeros(3), "odom": np.array([7.0, 0.0, 0.0])}
    parents = [first, *({"world", "odom"} - {first})]
    entries = []
    for stamp, xyz, quat in zip(poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, strict=True):
        for late, parent in enumerate(parents):
            vector = T["geometry_msgs/msg/Vector3"](*(xyz + shift[parent]))
            transform = T["geometry_msgs/msg/Transform"](vector, T["geometry_msgs/msg/Quaternion"](*quat))
            item = T["geometry_msgs/msg/TransformStamped"](
                bag_messages.header(stamp + late, parent), "base_link", transform
            )
            entries.append(("/tf", stamp + late, T["tf2_msgs/msg/TFMessage"]([item])))
    place = write_messages(tmp_path / "x", entries)
    for parent in parents:
        found = truth_as(place, TruthConfig(frame=f"{parent}:base_link"))
        np.testing.assert_allclose(found.positions, poses.positions + shift[parent], atol=1e-12)
    with pytest.raises(InputError, match=r"parents odom and world.*PARENT:CHILD"):
        truth_as(place, TruthConfig(frame="base_link"))


def mcap(path: Path, profile: bytes, encoding: str, poses: Trajectory) -> Path:
    """Write odometry as mcap without an index: header, schema, channel, messages, footer."""
    name = "nav_msgs/Odometry" if encoding == "ros1" else "nav_msgs/msg/Odometry"

    def text(value: bytes) -> bytes:
        return len(value).to_bytes(4, "little") + value

    def record(opcode: int, body: bytes) -> bytes:
        return bytes([opcode]) + len(body).to_bytes(8, "little") + body

    kind = b"ros1msg" if encoding == "ros1" else b"ros2msg"
    parts = [b"\x89MCAP0\r\n", record(1, text(profile) + text(b"test"))]
    parts.append(record(3, (1).to_bytes(2, "little") + text(name.encode()) + text(kind) + text(b"")))
    topic = text(b"/ground_truth/odometry") + text(encoding.encode()) + text(b"")
    parts.append(record(4, (0).to_bytes(2, "little") + (1).to_bytes(2, "little") + topic))
    for k, (stamp, xyz, quat) in enumerate(
        zip(poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, strict=True)
    ):
        raw = bytes(TYPESTORE.serialize_cdr(bag_messages.odometry(stamp, xyz, quat), "nav_msgs/msg/Odometry"))
        if encoding == "ros1":
            raw = bytes(TYPESTORE.cdr_to_ros1(raw, "nav_msgs/msg/Odometry"))
        head = (0).to_bytes(2, "little") + k.to_bytes(4, "little") + 2 * stamp.to_bytes(8, "little")
        parts.append(record(5, head + raw))
    parts += [record(15, bytes(4)), record(2, bytes(20)), b"\x89MCAP0\r\n"]
    path.write_bytes(b"".join(parts))
    return path


@pytest.mark.parametrize("profile", [b"ros2", b"", b"ros1", b"merged by a tool"])
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_channels_of_mcap_say_what_messages_are(tmp_path: Path, profile: bytes, encoding: str) -> None:
    poses = drive()
    place = mcap(tmp_path / "x.mcap", profile, encoding, poses)
    assert Bag(place).topics == {"/ground_truth/odometry": "nav_msgs/msg/Odometry"}
    found = read_truth(place)
    assert found.stamps_ns.tolist() == poses.stamps_ns.tolist()
    np.testing.assert_array_equal(found.positions, poses.positions)


def test_the_truth_of_a_bag_of_poses_alone_is_converted(tmp_path: Path, sfr: Sfr) -> None:
    poses = drive()
    place = mcap(tmp_path / "x.mcap", b"ros2", "cdr", poses)
    done = sfr("convert", place, tmp_path / "gt.csv")
    assert done.code == 0, done.err
    np.testing.assert_array_equal(read_trajectory_file(tmp_path / "gt.csv").trajectory.positions, poses.positions)


def test_channels_of_another_encoding_are_named(tmp_path: Path, sfr: Sfr) -> None:
    place = mcap(tmp_path / "x.mcap", b"ros2", "protobuf", drive())
    done = sfr("info", place)
    assert (done.code, "encoded as protobuf" in done.err) == (2, True)


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("form", ["bayer_{}8; png compressed", "bayer_{}8; jpeg compressed ", "bayer_{}8"])
def test_a_mosaic_in_a_compressed_image_is_the_mosaic_of_the_raw_image(order: str, form: str) -> None:
    rng = np.random.default_rng(1)
    mosaic = cv2.resize(rng.integers(0, 255, (6, 8), np.uint8), (64, 48), interpolation=cv2.INTER_CUBIC)
    mosaic[::2, ::2] //= 2
    raw = bag_messages.image(0, mosaic, "loc", "left")
    object.__setattr__(raw, "encoding", f"bayer_{order}8")
    ending = ".jpg" if "jpeg" in form else ".png"
    data = np.frombuffer(bytes(cv2.imencode(ending, mosaic, [cv2.IMWRITE_JPEG_QUALITY, 100])[1]), np.uint8)
    packed = T["sensor_msgs/msg/CompressedImage"](raw.header, form.format(order), data)
    difference = np.abs(samples_of(packed).grey().astype(int) - samples_of(raw).grey().astype(int))
    assert difference.max() <= (4 if "jpeg" in form else 0)
    colour = np.repeat(mosaic[:, :, None], 3, axis=2)
    data = np.frombuffer(bytes(cv2.imencode(".png", colour)[1]), np.uint8)
    ready = T["sensor_msgs/msg/CompressedImage"](raw.header, f"bayer_{order}8; png compressed bgr8", data)
    np.testing.assert_array_equal(samples_of(ready).grey(), mosaic)


@pytest.mark.parametrize(("name", "order"), [("RG", "rggb"), ("BG", "bggr"), ("GB", "gbrg"), ("GR", "grbg")])
@pytest.mark.parametrize("form", ["Bayer{}8; png compressed", "bayer_{}16; png compressed"])
def test_a_mosaic_by_its_name_of_genicam_is_one(name: str, order: str, form: str) -> None:
    mosaic = np.random.default_rng(1).integers(0, 255, (48, 64), np.uint8)
    data = np.frombuffer(bytes(cv2.imencode(".png", mosaic)[1]), np.uint8)
    header = bag_messages.header(0, "left")
    found = samples_of(T["sensor_msgs/msg/CompressedImage"](header, form.format(name), data))
    assert found.mosaic == order


def test_a_mosaic_of_unknown_order_is_not_taken_for_a_grey_image() -> None:
    data = np.frombuffer(bytes(cv2.imencode(".png", np.zeros((48, 64), np.uint8))[1]), np.uint8)
    header = bag_messages.header(0, "left")
    for form in ("bayer; png compressed", "bayer8", "BayerRGGB12p; png compressed "):
        with pytest.raises(InputError, match="is a Bayer mosaic of unknown order"):
            samples_of(T["sensor_msgs/msg/CompressedImage"](header, form, data))
    ready = T["sensor_msgs/msg/CompressedImage"](header, "bayer8; jpeg compressed mono8", data)
    assert samples_of(ready).mosaic == ""


def test_parts_of_a_bag_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in range(12):
        (tmp_path / f"drive_{number}.mcap").touch()
    assert [file.stem for file in bag_files(tmp_path).paths] == [f"drive_{number}" for number in range(12)]


def transform(stamp: int, parent: str, child: str, xyz: Any, quat: Any) -> Any:
    move, turn = T["geometry_msgs/msg/Vector3"](*xyz), T["geometry_msgs/msg/Quaternion"](*quat)
    moved = T["geometry_msgs/msg/Transform"](move, turn)
    stamped = T["geometry_msgs/msg/TransformStamped"](bag_messages.header(stamp, parent), child, moved)
    return T["tf2_msgs/msg/TFMessage"]([stamped])


def rows_of_drive() -> list[tuple[int, list[float], list[float]]]:
    poses = drive()
    return list(zip(poses.stamps_ns.tolist(), poses.positions.tolist(), poses.quats_xyzw.tolist(), strict=True))


def two_types(path: Path) -> Path:
    """Every other message of a topic is of another type, as in bags that were merged."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = ("geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry")
        topics = [writer.add_connection("/gt", kind, typestore=TYPESTORE) for kind in kinds]
        for number, (stamp, xyz, quat) in enumerate(rows_of_drive()):
            message = (pose, bag_messages.odometry)[number % 2](stamp, np.array(xyz), np.array(quat))
            writer.write(topics[number % 2], stamp, TYPESTORE.serialize_cdr(message, message.__msgtype__))
    return path


def compressed_messages(path: Path) -> Path:
    write_compressed(path, CompressionMode.MESSAGE)
    (path / "metadata.yaml").unlink()
    return path


def write_compressed(path: Path, mode: CompressionMode) -> None:
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/gt", "geometry_msgs/msg/PoseStamped", typestore=TYPESTORE)
        for row in rows_of_drive():
            writer.write(topic, row[0], TYPESTORE.serialize_cdr(pose(*row), topic.msgtype))


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_compressed_bag_is_read(tmp_path: Path, mode: CompressionMode) -> None:
    write_compressed(tmp_path / "x", mode)
    found = truth_as(tmp_path / "x", TruthConfig(source="/gt"))
    np.testing.assert_array_equal(found.positions, drive().positions)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("relative_file_paths", "file_paths", "relative_file_paths"),
        ("  - x.mcap\n", "  - other.mcap\n", "names 'other.mcap', which is missing"),
        ("compression_mode: ''", "compression_mode: file", "compressed by '', which is not supported"),
        (f"  message_count: {COUNT}\n  relative", "  message_count: 1000\n  relative", f"{COUNT} of 1000 messages"),
    ],
)
def test_metadata_that_contradict_the_files_are_one_line(tmp_path: Path, old: str, new: str, words: str) -> None:
    entries = [("/gt", row[0], pose(*row)) for row in rows_of_drive()]
    metadata = write_messages(tmp_path / "x", entries) / "metadata.yaml"
    (storage,) = (file for file in metadata.parent.iterdir() if file != metadata)
    text = metadata.read_text().replace(storage.name, "x.mcap")
    storage.rename(metadata.with_name("x.mcap"))
    assert old in text
    metadata.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=f"^[^\n]*{tmp_path}[^\n]*{words}[^\n]*$"):
        truth_as(metadata.parent, TruthConfig(source="/gt"))


def test_files_of_a_split_recording_are_read_in_the_order_of_time(tmp_path: Path) -> None:
    """The second file overlaps the third in time, and the names are not in the order of time."""
    (tmp_path / "x").mkdir()
    parts = {"x_2": slice(0, 5), "x_0": slice(5, 12, 2), "x_1": slice(6, None, 1)}
    for name, part in parts.items():
        bag = write_messages(tmp_path / name, [("/gt", row[0], pose(*row)) for row in rows_of_drive()[part]])
        storage = next(file for file in bag.iterdir() if file.name != "metadata.yaml")
        storage.rename(tmp_path / "x" / f"{name}{storage.suffix}")
    bag = Bag(tmp_path / "x")
    times = [stamp_ns for _, stamp_ns, _ in bag.stream([bag.find("/gt")])]
    assert times == sorted(times)
    assert len(times) == 5 + 4 + COUNT - 6


def frames(*edges: tuple[str, str]) -> Callable[[Path], Path]:
    rows = [(stamp, edge, xyz, quat) for stamp, xyz, quat in rows_of_drive() for edge in edges]
    entries = [("/tf", stamp, transform(stamp, *edge, xyz, quat)) for stamp, edge, xyz, quat in rows]
    return lambda path: write_messages(path, entries)


def folder_of_bags(path: Path) -> Path:
    path.mkdir()
    two_types(path / "inner")
    return path


UNREADABLE: dict[str, tuple[Callable[[Path], Path], TruthConfig, str]] = {
    "two types": (two_types, TruthConfig(source="/gt"), "several types, geometry_msgs/msg/PoseStamped and nav_msgs"),
    "compressed": (compressed_messages, TruthConfig(source="/gt"), "zstd, which only metadata.yaml states"),
    "a frame in itself": (frames(("base", "base")), TruthConfig(frame="base"), "a loop at 'base': base in base"),
    "a loop": (frames(("a", "b"), ("b", "a")), TruthConfig(frame="b"), "a loop at 'b': b in a in b"),
    "no bag": (folder_of_bags, TruthConfig(source="/gt"), "is not a bag: give a file, or a topic of a bag"),
}


@pytest.mark.parametrize("what", UNREADABLE)
def test_a_truth_that_cannot_be_read_is_one_line_with_the_reason(tmp_path: Path, what: str) -> None:
    write, config, words = UNREADABLE[what]
    path = write(tmp_path / "x")
    with pytest.raises(InputError, match=f"^[^\n]*{tmp_path}[^\n]*{words}[^\n]*$"):
        truth_as(path, config)


@pytest.mark.parametrize("number", [0, 9, COUNT - 1])
def test_a_stray_stamp_of_a_truth_is_ignored_and_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, number: int
) -> None:
    entries = [("/gt", row[0], pose(0 if k == number else row[0], *row[1:])) for k, row in enumerate(rows_of_drive())]
    found = truth_as(write_messages(tmp_path / "x", entries), TruthConfig(source="/gt"))
    assert found.stamps_ns.tolist() == np.delete(drive().stamps_ns, number).tolist()
    assert f"1 of {COUNT} poses have stamps that are 0" in caplog.text
