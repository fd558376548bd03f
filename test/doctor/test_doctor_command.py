"""`sfr info` on bags and `sfr doctor` on running graphs, with one fault in each: exactly its cause is reported."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import broken_sources as broken
from helpers.cli_result import Sfr
from helpers.made_scene import LOC_RIG, write_bag
from helpers.processes import Process, wait_until
from sfr_loc_map.doctor.examination import examine
from sfr_loc_map.doctor.observation import Observation, ObservedTopic, SourceKind
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.message_types import CAMERA_INFO, IMAGE
from sfr_loc_map.transport_issues import Publisher, Reliability

Edit = broken.Edit
RIGHT_INFO = "/loc/right/camera_info"


def edit_of(part: str, **changes: Any) -> Edit:
    """Change fields of the messages on the topics whose name has a part."""
    return lambda topic, number, message: replace(message, **changes) if part in topic else message


def without(part: str) -> Edit:
    return lambda topic, number, message: None if part in topic else message


def stamped(part: str, shift_ns: int, number: int | None = None) -> Edit:
    """Shift the stamps of topics, or that of one message each."""

    def edit(topic: str, place: int, message: Any) -> Any:
        if part in topic and number in (None, place) and not topic.endswith("camera_info"):
            stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec + shift_ns
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        return message

    return edit


def no_baseline(topic: str, number: int, message: Any) -> Any:
    return replace(message, p=np.where(np.arange(12) == 3, 0.0, message.p)) if topic == RIGHT_INFO else message


def mirrored_order(topic: str, number: int, message: Any) -> Any:
    """Mirror both images of the drive: what was further left is then further right, as in swapped images."""
    if "/loc/" not in topic or not topic.endswith("image_rect"):
        return message
    data = message.data.reshape(message.height, message.width)[:, ::-1]
    return replace(message, data=np.ascontiguousarray(data).reshape(-1))


BAGS: dict[str, tuple[Edit, list[tuple[str, bool]]]] = {
    "good": (edit_of("none"), []),
    "not rectified": (edit_of("/loc/left/camera_info", p=np.zeros(12)), [("camera_info", True)]),
    "no baseline": (no_baseline, [("camera_info", True)]),
    "unequal sizes": (edit_of("/loc/right/camera_info", width=100), [("camera_info", True)]),
    "no camera_info": (without("/loc/left/camera_info"), [("silent", True)]),
    "unsynchronised": (stamped("/loc/right/", 30_000_000), [("unsynchronised", True)]),
    "right images within the tolerance": (stamped("/loc/right/", 7_000_000), []),
    "unknown encoding": (edit_of("loc/left/image_rect", encoding="yuv411"), [("encoding", True)]),
    "other camera's info": (edit_of("loc/", width=80), [("camera_info", True), ("image_size", True)]),
    "swapped": (mirrored_order, [("swapped", True)]),
    "two runs": (stamped("/loc/", -100 * 10**9, 2), [("stamp_order", True), ("stamp_order", True)]),
    "no truth": (without("/ground_truth/odometry"), [("truth", False)]),
    "truth by another clock": (stamped("/ground_truth/odometry", 100 * 10**9), [("truth_clock", False)]),
    "frames not joined": (edit_of("/tf_static", transforms=[]), [("frames", True)]),
    "poses of other stamps": (stamped("/nav/pose", 30_000_000), [("pose_stamps", True)]),
    "poses within the tolerance": (stamped("/nav/pose", 7_000_000), []),
}


@pytest.mark.parametrize("name", BAGS)
def test_a_bag_with_one_thing_wrong(tmp_path: Path, sfr: Sfr, name: str) -> None:
    edit, expected = BAGS[name]
    if name == "other camera's info":
        edit, expected = _smaller_camera, [("image_size", True)]
    bag = broken.rewritten_bag(tmp_path / "x.mcap", edit)
    result = sfr("info", bag, "--json", "-")
    findings = json.loads(result.out)["issues"]
    assert [(f["cause"], f["is_blocking"]) for f in findings] == expected, findings
    assert result.code == int(any(stops for _, stops in expected))
    assert all(f["fix"] and f["where"] for f in findings)
    if name not in ("good", "swapped"):
        return
    plain = sfr("info", bag)
    assert plain.out.count("fix: ") == len(expected)
    assert ("no blocking issue" in plain.out) == (not expected)


def _smaller_camera(topic: str, number: int, message: Any) -> Any:
    return replace(message, width=80) if topic.startswith("/loc/") and topic.endswith("camera_info") else message


def test_bags_whose_topics_are_not_ours_or_that_were_not_finished(tmp_path: Path, sfr: Sfr) -> None:
    other = broken.renamed_bag(tmp_path / "other.mcap", "image_rect", "image")
    result = sfr("info", other, "--json", "-")
    assert result.code == 1
    (finding,) = json.loads(result.out)["issues"][:1]
    assert finding["cause"] == "no_topic"
    bag = write_bag(tmp_path / "whole.mcap", 3, 0)
    names = ("loc/right/camera_info", "loc/right/image_rect")
    result = sfr("info", bag, *(f"--remap={a}:={b}" for a, b in (names, names[::-1])))
    assert "the type is sensor_msgs/msg/CameraInfo" in result.out
    (storage,) = bag.glob("*.mcap")
    (bag / "metadata.yaml").unlink()
    storage.write_bytes(storage.read_bytes()[:-100])
    result = sfr("info", bag, "--json", "-")
    assert [(f["cause"], f["is_blocking"]) for f in json.loads(result.out)["issues"]] == [("unfinished", False)]
    assert result.code == 0


def test_a_parameter_file_may_say_where_the_cameras_are(tmp_path: Path, sfr: Sfr) -> None:
    bag = broken.rewritten_bag(tmp_path / "x.mcap", edit_of("/tf_static", transforms=[]))
    config = tmp_path / "p.yaml"
    for quat, code in (("[0.0, 0.0, 0.0, 1.0]", 0), ("[0.0, 0.0, 0.0, 0.0]", 1)):
        config.write_text(f"/**/localisation_node:\n  ros__parameters:\n    T_rb_locsb:\n      quat_xyzw: {quat}\n")
        assert sfr("info", bag, "--config", config).code == code


SOURCES: dict[str, tuple[Callable[[Path], object], list[tuple[str, bool]]]] = {
    "good": (lambda path: None, []),
    "no truth": (lambda path: (path / "loc/groundtruth.csv").unlink(), [("truth", False)]),
    "an image is missing": (lambda path: (path / "loc/left/000001.png").unlink(), [("missing_images", False)]),
    "an image is broken": (lambda path: (path / "nav/left/000001.png").write_bytes(b"png"), [("broken", True)]),
    "no rig": (lambda path: (path / "loc/rig.json").write_text("{"), [("broken", True)]),
}


@pytest.mark.parametrize("name", SOURCES)
def test_a_source_of_files_is_examined_as_a_bag_is(tmp_path: Path, sfr: Sfr, name: str) -> None:
    change, expected = SOURCES[name]
    source = broken.good_folder(tmp_path / "source")
    change(source)
    result = sfr("info", source, "--json", "-")
    found = [(finding["cause"], finding["is_blocking"]) for finding in json.loads(result.out)["issues"]]
    assert found == expected
    assert result.code == int(any(stops for _, stops in expected))


def test_images_lost_on_their_way_are_the_transport_and_not_the_stamps() -> None:
    """A camera driver with the 0.5 MB of shared memory that Fast DDS has unless told otherwise."""
    every, period_ns = np.arange(100, dtype=np.int64), 100_000_000
    kept = {side: np.delete(every, np.s_[first::5]) for side, first in (("left", 1), ("right", 3))}

    def found(lost: int) -> list[tuple[str, bool, str]]:
        topics = {}
        for side, stamps in kept.items():
            image = bag_messages.image(0, np.zeros((LOC_RIG.height, LOC_RIG.width), np.uint8), "loc", side)
            info = bag_messages.camera_info(0, LOC_RIG, "loc", side)
            of_image, of_info = (
                (Publisher("/camera", kind, Reliability.BEST_EFFORT),) for kind in (IMAGE, CAMERA_INFO)
            )
            times = stamps * period_ns
            topics |= {
                f"loc/{side}/image_rect": ObservedTopic("x", (IMAGE,), of_image, times, (image,), lost=lost),
                f"loc/{side}/camera_info": ObservedTopic("y", (CAMERA_INFO,), of_info, stamps, (info,)),
            }
        line = "export A=/there/fastdds_shm.xml"
        seen = Observation("graph", SourceKind.GRAPH, topics=topics, extrinsics_given=True, export_line=line)
        return [(f.cause.value, f.is_blocking, f"{f.text} {f.fix}") for f in examine(seen) if f.cause != "truth"]

    ((cause, blocks, text),) = found(lost=20)
    assert (cause, blocks) == ("transport", True)
    assert "20% of the images are lost" in text
    assert "`export A=/there/fastdds_shm.xml`" in text
    assert [found(lost=n)[0][:2] for n in (2, 0)] == [("transport", False), ("unpaired", False)]


COMMAND = ("-m", "sfr_loc_map")
GRAPHS = {
    "good": [],
    "no publisher": [("no_publisher", True)],
    "wrong type": [("wrong_type", True)],
    "clocks apart": [("clocks_apart", False)],
}


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Return report, exit code and text of the doctor for rovers in a ROS domain each."""
    pytest.importorskip("rclpy")
    from sfr_loc_map.ros import environment
    from sfr_loc_map.ros.domains import hold_domain

    folder = tmp_path_factory.mktemp("rovers")
    mount = folder / "mount.yaml"
    mount.write_text("/**/localisation_node:\n  ros__parameters:\n    T_rb_locsb.quat_xyzw: [0.0, 0.0, 0.0, 1.0]\n")
    variables: dict[str, dict[str, str]] = {}
    domains = {what: hold_domain() for what in GRAPHS}
    for what, domain in domains.items():
        variables[what] = {
            "ROS_DOMAIN_ID": str(domain.number),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(folder),
        }
        environment.prepare(variables[what])
    with ExitStack() as stack:
        for domain in domains.values():
            stack.enter_context(domain)

        def start(name: str, what: str, *command: str) -> Process:
            return stack.enter_context(Process(folder / f"{name}.log", *command, environment=variables[what]))

        rovers = [f"{what}@{variables[what]['ROS_DOMAIN_ID']}" for what in GRAPHS]
        start("rovers", "good", "-m", "helpers.rover_process", *rovers).wait_for("ready")
        doctors = {}
        for what in GRAPHS:
            options = ["--seconds", "2", "--json", str(folder / f"{what}.json"), "--config", str(mount)]
            doctors[what] = start(f"{what}_doctor", what, *COMMAND, "doctor", *options)
        for process in doctors.values():
            wait_until(lambda process=process: process.popen.poll() is not None, "the end of a doctor")
        yield {
            what: (json.loads((folder / f"{what}.json").read_text()), process.popen.returncode, process.text)
            for what, process in doctors.items()
        }


@pytest.mark.ros
@pytest.mark.parametrize("what", GRAPHS)
def test_a_graph_with_one_thing_wrong(verdicts: dict[str, Any], what: str) -> None:
    report, code, text = verdicts[what]
    findings = report["issues"]
    assert [(f["cause"], f["is_blocking"]) for f in findings] == GRAPHS[what], findings
    assert code == int(any(stops for _, stops in GRAPHS[what]))
    assert text.count("fix: ") == len(GRAPHS[what])
