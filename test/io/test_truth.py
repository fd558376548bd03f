"""Truth from every kind of topic and file, with a lever arm, a clock offset, a noise and without attitude."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.message_bags import write_messages
from helpers.score_rows import number
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_multiply, quat_normalised, quat_rotate
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.registry import read_truth
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory, trajectory_text
from sfr_loc_map.io.truth.config import TruthConfig
from sfr_loc_map.io.truth.messages import enu_m
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.scoring.load_trajectories import load_trajectories

T = TYPESTORE.types
COUNT = 40
STAMPS = 1_700_000_000 * NS_PER_S + np.arange(COUNT) * 100_000_001
LEVER, TURN = np.array([0.3, -0.2, 1.1]), quat_normalised([0.1, -0.2, 0.3, 0.9])


def truth_as(place: Path, config: TruthConfig) -> Truth:
    return read_truth(place, SourceConfig(truth=config))


@pytest.fixture
def poses() -> Trajectory:
    """A climbing curve with roll, pitch and yaw."""
    s = np.linspace(0.0, 6.0, COUNT)
    quats = quat_normalised(np.column_stack((0.05 * np.sin(s), 0.1 * np.cos(s), np.sin(0.3 * s), np.cos(0.3 * s))))
    return Trajectory(STAMPS, np.column_stack((s, np.sin(s), 0.1 * s)), quats)


def messages(kind: str, poses: Trajectory, covariance: float = 0.0) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, stamp and message of one kind of truth."""
    vector, place, turn = (T[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Point", "Quaternion"))
    stamped = []
    for stamp, xyz, quat in zip(poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, strict=True):
        header = bag_messages.header(stamp, "world")
        pose = T["geometry_msgs/msg/Pose"](place(*xyz), turn(*quat))
        with_covariance = T["geometry_msgs/msg/PoseWithCovariance"](pose, np.diag([covariance] * 6).ravel())
        transform = T["geometry_msgs/msg/Transform"](vector(*xyz), turn(*quat))
        moved = T["geometry_msgs/msg/TransformStamped"](header, "marker", transform)
        stamped.append(T["geometry_msgs/msg/PoseStamped"](header, pose))
        if kind == "odometry":
            message = bag_messages.odometry(stamp, xyz, quat)
            yield "/ground_truth/odometry", stamp, message
        elif kind == "pose":
            yield "/vrpn/pose", stamp, stamped[-1]
        elif kind == "pose_with_covariance":
            name = "geometry_msgs/msg/PoseWithCovarianceStamped"
            yield "/slam/pose", stamp, T[name](header, with_covariance)
        elif kind == "transform":
            yield "/vicon/rover", stamp, moved
        elif kind == "path":
            yield "/gt/path", stamp, T["nav_msgs/msg/Path"](header, list(stamped))
        elif kind == "tf":
            yield "/tf", stamp, T["tf2_msgs/msg/TFMessage"]([moved])


TOPICS = {"odometry": "", "pose": "/vrpn/pose", "pose_with_covariance": "slam/pose", "transform": "/vicon/rover"}
TOPICS |= {"path": "/gt/path", "tf": ""}


@pytest.mark.parametrize("kind", TOPICS)
def test_a_lever_arm_and_a_clock_are_undone_in_every_kind_of_topic(
    tmp_path: Path, poses: Trajectory, kind: str
) -> None:
    marker = Trajectory(
        poses.stamps_ns - 250_000_000,
        poses.positions + quat_rotate(poses.quats_xyzw, LEVER),
        quat_multiply(poses.quats_xyzw, TURN),
    )
    place = write_messages(tmp_path / "x", messages(kind, marker, 0.0004))
    frame = "world:marker" if kind == "tf" else ""
    lever = {"lever_arm_m": tuple(LEVER), "lever_quat_xyzw": tuple(TURN), "clock_offset_s": 0.25}
    truth = truth_as(place, TruthConfig(source=TOPICS[kind], frame=frame, **lever))
    assert truth.stamps_ns.tolist() == poses.stamps_ns.tolist()
    np.testing.assert_allclose(truth.positions, poses.positions, atol=1e-12)
    turned = quat_multiply(quat_conjugate(poses.quats_xyzw), truth.quats_xyzw)
    np.testing.assert_allclose(np.abs(turned[:, 3]), 1.0, atol=1e-12)
    assert truth.has_attitude
    assert truth.lever_arm_m == (0.0, 0.0, 0.0)
    assert truth.sigma_m == pytest.approx(0.02 if kind == "pose_with_covariance" else 0.0)


def test_a_lever_arm_is_not_scaled_by_rounded_quaternions(tmp_path: Path, poses: Trajectory) -> None:
    """Both quaternions have a norm of 1.004, as of numbers with two digits."""
    marker = poses.positions + quat_rotate(poses.quats_xyzw, 10 * LEVER)
    rounded = Trajectory(poses.stamps_ns, marker, 1.004 * quat_multiply(poses.quats_xyzw, TURN))
    place = write_messages(tmp_path / "x", messages("odometry", rounded))
    truth = truth_as(place, TruthConfig(lever_arm_m=tuple(10 * LEVER), lever_quat_xyzw=tuple(1.004 * TURN)))
    np.testing.assert_allclose(truth.positions, poses.positions, atol=1e-9)


@pytest.mark.parametrize("kind", TOPICS)
def test_times_of_recording_replace_the_stamps_or_are_refused(tmp_path: Path, poses: Trajectory, kind: str) -> None:
    """The poses of a path and of /tf have stamps of their own, which the time of one message cannot replace."""
    entries = [(topic, stamp + NS_PER_S, message) for topic, stamp, message in messages(kind, poses)]
    place = write_messages(tmp_path / "x", entries)
    frame = "world:marker" if kind == "tf" else ""
    config = TruthConfig(source=TOPICS[kind], frame=frame, stamps="record")
    if kind in ("path", "tf"):
        with pytest.raises(InputError, match=r"truth\.stamps=record does not apply to .*: omit"):
            truth_as(place, config)
    else:
        assert truth_as(place, config).stamps_ns.tolist() == [stamp for _, stamp, _ in entries]


@pytest.mark.parametrize("kind", ["pose", "transform", "path", "tf"])
def test_an_invalid_pose_is_skipped_and_reported(
    tmp_path: Path, poses: Trajectory, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    quats = poses.quats_xyzw.copy()
    quats[5] = 0.0
    recorded: Any = SimpleNamespace(stamps_ns=poses.stamps_ns, positions=poses.positions, quats_xyzw=quats)
    place = write_messages(tmp_path / "x", messages(kind, recorded))
    truth = truth_as(place, TruthConfig(source=TOPICS[kind], frame="marker" if kind == "tf" else ""))
    assert truth.stamps_ns.tolist() == np.delete(STAMPS, 5).tolist()
    assert f"1 of {COUNT} poses skipped" in caplog.text


def test_a_topic_named_as_truth_has_priority_over_a_frame(
    tmp_path: Path, poses: Trajectory, caplog: pytest.LogCaptureFixture
) -> None:
    place = write_messages(tmp_path / "x", messages("pose", poses))
    truth = truth_as(place, TruthConfig(source=TOPICS["pose"], frame="marker"))
    assert "/vrpn/pose" in truth.read_from
    assert "truth.frame=marker ignored" in caplog.text


def test_a_frame_on_both_topics_of_transforms_is_moving(tmp_path: Path, poses: Trajectory) -> None:
    entries = list(messages("tf", poses))
    _, _, static = entries[-1]
    place = write_messages(tmp_path / "x", [("/tf_static", int(STAMPS[0]), static), *entries])
    truth = truth_as(place, TruthConfig(frame="marker"))
    assert truth.stamps_ns.tolist() == STAMPS.tolist()


def tf(stamp: int, parent: str, child: str, x: float) -> Any:
    vector, turn = T["geometry_msgs/msg/Vector3"], T["geometry_msgs/msg/Quaternion"]
    transform = T["geometry_msgs/msg/Transform"](vector(x, 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0))
    item = T["geometry_msgs/msg/TransformStamped"](bag_messages.header(stamp, parent), child, transform)
    return T["tf2_msgs/msg/TFMessage"]([item])


def test_an_empty_last_path_is_ignored_and_a_window_of_poses_is_reported(
    tmp_path: Path, poses: Trajectory, caplog: pytest.LogCaptureFixture
) -> None:
    paths = list(messages("path", poses))
    topic, stamp, last = paths[-1]
    read = TruthConfig(source=TOPICS["path"])
    empty = write_messages(tmp_path / "empty", [*paths, (topic, stamp + NS_PER_S, replace(last, poses=[]))])
    assert len(truth_as(empty, read)) == COUNT
    assert not caplog.text
    windows = [(topic, stamp, replace(path, poses=path.poses[-5:])) for topic, stamp, path in paths]
    assert len(truth_as(write_messages(tmp_path / "window", windows), read)) == 5
    assert f"{COUNT - 1} of {COUNT} paths begin up to" in caplog.text


def test_poses_are_not_interpolated_over_a_gap_of_a_transform(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """world to odom is recorded for 5 s, odom to base only in the first and the last 0.2 s."""
    step = NS_PER_S // 10
    entries = [("/tf", k * step, tf(k * step, "world", "odom", float(k))) for k in range(53)]
    entries += [("/tf", k * step, tf(k * step, "odom", "base", 0.0)) for k in (0, 1, 2, 50, 51, 52)]
    found = truth_as(write_messages(tmp_path / "x", entries), TruthConfig(frame="base"))
    assert (found.stamps_ns // step).tolist() == [0, 1, 2, 50, 51, 52]
    assert "47 of 53 poses" in caplog.text
    apart = write_messages(tmp_path / "y", [*entries[:20], ("/tf", 60 * step, tf(60 * step, "odom", "base", 0.0))])
    with pytest.raises(InputError, match="record all transforms together"):
        truth_as(apart, TruthConfig(frame="base"))


def test_transforms_of_a_tree_are_joined_and_interpolated(tmp_path: Path) -> None:
    """world to odom and odom to base move, base to marker is fixed; frames that are not joined are refused."""
    entries = [("/tf_static", 0, tf(0, "base", "marker", 0.5))]
    entries += [("/tf", k * NS_PER_S, tf(k * NS_PER_S, "world", "odom", float(k))) for k in range(3)]
    entries += [("/tf", k * NS_PER_S // 2, tf(k * NS_PER_S // 2, "odom", "base", 10.0)) for k in range(7)]
    place = write_messages(tmp_path / "x", entries)
    found = truth_as(place, TruthConfig(frame="marker"))
    np.testing.assert_allclose(found.positions[:, 0], 10.5 + np.arange(5) / 2)
    with pytest.raises(InputError, match="no moving transform 'map:marker' on /tf: it has odom:base"):
        truth_as(place, TruthConfig(frame="map:marker"))


def test_fixes_become_metres_east_north_and_up_with_their_sigma(tmp_path: Path) -> None:
    status, fix = T["sensor_msgs/msg/NavSatStatus"], T["sensor_msgs/msg/NavSatFix"]
    covariance = np.diag([0.01, 0.04, 0.09]).ravel()
    places = [(0, 48.0, 11.0, 500.0), (0, 48.0001, 11.0, 500.0), (-1, 0.0, 0.0, 0.0), (0, 48.0, 11.0001, 501.0)]
    entries = [
        ("/fix", k * NS_PER_S, fix(bag_messages.header(k * NS_PER_S, "gps"), status(code, 1), *place, covariance, 2))
        for k, (code, *place) in enumerate(places)
    ]
    found = truth_as(write_messages(tmp_path / "x", entries), TruthConfig(source="/fix", lever_arm_m=tuple(LEVER)))
    assert found.stamps_ns.tolist() == [0, NS_PER_S, 3 * NS_PER_S]
    # lengths of a degree at this latitude (series of Snyder 1987, page 25): 111 200.1 m north, 74 625.2 m east
    np.testing.assert_allclose(found.positions[1], [0.0, 11.1209, 0.0], atol=2e-3)
    np.testing.assert_allclose(found.positions[2], [7.4632, 0.0, 1.0], atol=2e-3)
    assert not found.has_attitude
    assert found.lever_arm_m == tuple(LEVER)
    assert found.sigma_m == pytest.approx(np.sqrt(0.14 / 3))
    assert np.abs(enu_m(np.array([[10.0, 20.0, 30.0]]))).max() == 0.0


TABLES = {
    "total station": "Time (s);East (m);North (m);Height (mm)\n1,5;1,0;2,0;500\n2.5;;;\n3;4;5;6000\n",
    "motion capture": "stamp_ms,tx_mm,ty_mm,tz_mm,extra\n1500,1000,2000,500,a\n3000,4000,5000,6000,b\n",
    "utc": "Timestamp[utc]\tX[m]\tY[m]\tZ[m]\n1970-01-01T00:00:01.5\t1\t2\t0.5\n1970-01-01 01:00:03+01:00\t4\t5\t6\n",
}


@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES)
def test_a_table_is_read_by_the_names_and_units_of_its_header(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.csv").write_text(text)
    found = read_truth(tmp_path / "x.csv")
    assert found.stamps_ns.tolist() == [1_500_000_000, 3_000_000_000]
    np.testing.assert_allclose(found.positions, [[1.0, 2.0, 0.5], [4.0, 5.0, 6.0]])
    assert not found.has_attitude


def test_no_unit_is_guessed_and_columns_can_be_named(tmp_path: Path, poses: Trajectory) -> None:
    place = tmp_path / "x.csv"
    rows = np.column_stack((np.arange(COUNT), 1000.0 * poses.positions, poses.quats_xyzw))
    lines = [",".join(map(repr, row)) for row in rows.tolist()]
    place.write_text("\n".join(["Frame,TX,TY,TZ,qx,qy,qz,qw", *lines]))
    with pytest.raises(InputError, match=r"line 1 is 'Frame,TX,.*t not found.*--columns"):
        read_truth(place)
    columns = "t=Frame[ms],x=TX[mm],y=TY[mm],z=TZ[mm],qx=qx,qy=qy,qz=qz,qw=qw"
    found = truth_as(place, TruthConfig(columns=columns))
    assert found.has_attitude
    assert found.stamps_ns[-1] == (COUNT - 1) * 1_000_000
    np.testing.assert_allclose(found.positions, poses.positions, atol=1e-12)
    assert not truth_as(place, TruthConfig(columns=columns, attitude="no")).has_attitude
    place.write_text("\n".join(["Frame[ms],TX[mm],TY[mm],TZ [mm],qx,qy,qz,qw", *lines]))  # named as they stand there
    found = truth_as(place, TruthConfig(columns="t=Frame[ms],x=TX[mm],y=TY[mm],z=TZ [mm]"))
    np.testing.assert_allclose(found.positions, poses.positions, atol=1e-12)
    with pytest.raises(InputError, match="no column for 'w=q'"):
        truth_as(place, TruthConfig(columns="w=q"))


def test_eight_columns_without_a_header_are_ambiguous(tmp_path: Path, poses: Trajectory) -> None:
    """The csv of the suite without its header would be read as EuRoC, with other quaternions."""
    (tmp_path / "x.csv").write_text(trajectory_text(poses).split("\n", 1)[1])
    with pytest.raises(InputError, match="8 columns and no header; possible layouts are"):
        read_trajectory_file(tmp_path / "x.csv")
    save_trajectory(tmp_path / "x.euroc.csv", poses)
    np.testing.assert_array_equal(read_trajectory_file(tmp_path / "x.euroc.csv").trajectory.positions, poses.positions)


@pytest.mark.parametrize("source", ["/odometry", "/ground_truth/odometry"])
def test_an_absolute_name_of_the_truth_matches_exactly(tmp_path: Path, poses: Trajectory, source: str) -> None:
    entries = [(f"/rover2{topic}", *rest) for topic, *rest in messages("odometry", poses)]
    bag = write_messages(tmp_path / "bag", entries)
    for found in ("/rover2/ground_truth/odometry", "ground_truth/odometry"):
        assert len(truth_as(bag, TruthConfig(source=found))) == COUNT
    with pytest.raises(InputError, match="neither a file nor a topic"):
        truth_as(bag, TruthConfig(source=source))


def test_a_truth_on_another_topic_states_the_selection(tmp_path: Path, poses: Trajectory) -> None:
    """The recording may have its own true poses as well, so that the selection is a property of the truth."""
    own = [("/ground_truth/odometry", *rest) for _, *rest in messages("odometry", poses)]
    bag = write_messages(tmp_path / "bag", [*own, *messages("pose", poses)])
    assert read_truth(bag).declared == ()
    assert truth_as(bag, TruthConfig(source="/vrpn/pose")).declared[0] == "truth.source=/vrpn/pose"


@pytest.mark.parametrize("place", ["beside", "inside"])
def test_the_truth_of_a_bag_is_read_with_the_sfr_yaml_of_its_source(
    tmp_path: Path, poses: Trajectory, place: str
) -> None:
    """`read_truth`, pages of trajectories and `open_source` use the same configuration."""
    bag = write_messages(tmp_path / "bag", [*messages("pose", poses)])
    folder = bag if place == "inside" else tmp_path
    (folder / "sfr.yaml").write_text("truth:\n  source: /vrpn/pose\n  lever_arm_m: [0.3, -0.2, 1.1]\n")
    configured = truth_as(bag, TruthConfig(source="/vrpn/pose", lever_arm_m=(0.3, -0.2, 1.1)))
    for found in (read_truth(bag), load_trajectories([bag], None)[0]["bag"]):
        np.testing.assert_array_equal(found.positions, configured.positions)


def test_truth_that_is_not_there_names_what_could_be(tmp_path: Path, poses: Trajectory) -> None:
    place = write_messages(tmp_path / "x", messages("pose", poses))
    with pytest.raises(InputError, match=r"name their topic .*: /vrpn/pose"):
        read_truth(place)
    with pytest.raises(InputError, match="neither a file nor a topic"):
        truth_as(place, TruthConfig(source="/none"))
    (tmp_path / "y.csv").write_text(TABLES["total station"])
    with pytest.raises(InputError, match="has no attitudes"):
        truth_as(place, TruthConfig(source=str(tmp_path / "y.csv"), attitude="yes"))


# ---- to a score, by the command line

KINDS = (*TOPICS, "tum", "kitti", "euroc", "csv", "columns", "prism", "fix")
CLOSE = {"prism": 2e-3, "fix": 2e-3}
"""How far the figure may be from that of the plain truth, m: positions alone are fitted, and the chord is another."""


def truth_place(kind: str, folder: Path, poses: Trajectory) -> tuple[Path, list[str]]:
    """Write one kind of truth, of a body on a lever; return its place and what is said of it."""
    marker = Trajectory(
        poses.stamps_ns, poses.positions + quat_rotate(poses.quats_xyzw, LEVER), quat_multiply(poses.quats_xyzw, TURN)
    )
    lever = [f"truth.lever_arm_m={LEVER.tolist()}"]
    turned = [*lever, f"truth.lever_quat_xyzw={TURN.tolist()}"]
    if kind in TOPICS:
        where = ["truth.frame=world:marker"] if kind == "tf" else [f"truth.source={TOPICS[kind]}"] * bool(TOPICS[kind])
        return write_messages(folder / "bag", messages(kind, marker, 0.0004)), [*turned, *where]
    if kind == "fix":
        status, fix = T["sensor_msgs/msg/NavSatStatus"](0, 1), T["sensor_msgs/msg/NavSatFix"]
        scale = np.array([111_278.4, 74_548.9])  # metres of a degree of latitude and of longitude there
        entries = [
            (
                "/fix",
                stamp,
                fix(bag_messages.header(stamp, "gps"), status, 48 + y / scale[0], 11 + x / scale[1], z, np.zeros(9), 0),
            )
            for stamp, (x, y, z) in zip(marker.stamps_ns.tolist(), marker.positions.tolist(), strict=True)
        ]
        return write_messages(folder / "bag", entries), [*lever, "truth.source=/fix"]
    names = {"tum": "x.tum", "kitti": "x.kitti", "euroc": "x.euroc.csv", "csv": "x.csv"}
    if kind in names:
        save_trajectory(folder / names[kind], marker)
        return folder / names[kind], turned
    rows = np.column_stack((marker.positions, marker.quats_xyzw)).tolist()
    head = "time_ns,x [m],y [m],z [m],qx,qy,qz,qw" if kind == "columns" else "time_ns,east [m],north [m],height [m]"
    lines = [
        ",".join(map(repr, [stamp, *row[: head.count(",")]])) for stamp, row in zip(STAMPS.tolist(), rows, strict=True)
    ]
    (folder / "x.csv").write_text("\n".join([head, *lines]))
    return folder / "x.csv", turned if kind == "columns" else lever


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_truth_comes_to_the_same_score(tmp_path: Path, poses: Trajectory, sfr: Sfr, kind: str) -> None:
    drift = np.cumsum(np.random.default_rng(2).normal(0.0, 1e-3, (COUNT, 3)), axis=0)
    estimate = Trajectory(poses.stamps_ns, poses.positions + drift, poses.quats_xyzw)
    save_trajectory(tmp_path / "estimate.csv", estimate)
    save_trajectory(tmp_path / "plain.csv", poses)
    found = []
    place, settings = truth_place(kind, tmp_path, poses)
    for truth, said in ((tmp_path / "plain.csv", []), (place, settings)):
        words = [word for item in said for word in ("--set", item)]
        done = sfr(
            "score",
            tmp_path / "estimate.csv",
            truth,
            "--condition",
            "distance=2",
            "--spacing",
            2,
            "--json",
            "-",
            *words,
        )
        assert done.code == 0, done.err
        found.append(json.loads(done.out))
    plain, other = found
    alone = kind in ("prism", "fix")
    assert number(other, "position", "n") >= number(plain, "position", "n") - 3 > 5
    assert (number(other, "attitude", "mean") is None) is alone
    assert (other["association"]["rebase"] in ("yaw_aligned", "rotation_aligned")) is alone
    figure = "chord" if alone else "position"
    expected = number(plain, figure, "mean_plus_3sigma")
    assert number(other, figure, "mean_plus_3sigma") == pytest.approx(expected, abs=CLOSE.get(kind, 1e-9))
    assert (other["truth"]["sigma_m"] is not None) is (kind == "pose_with_covariance")
    assert other["truth"]["attitude"] is not alone
