from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from made_scene import LOC_RIG, START_NS, loc_pair, nav_pair, true_pose, write_bag, write_folder

from sfr_loc_map.io.bag import TYPESTORE
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import image_from_message
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.pipeline.message_stream import end_of, messages_of, topics_of


def played(path: Path, remap: dict[str, str] | None = None) -> list:
    source = open_source(path, remap or {})
    messages = list(messages_of(source, remap or {}))
    types = topics_of(source, remap or {})
    assert {m.topic: m.msgtype for m in messages} == types
    return messages


@pytest.mark.parametrize("kind", ["folder", "bag"])
def test_all_messages_of_a_source_come_whole(tmp_path: Path, kind: str) -> None:
    path = write_folder(tmp_path / "f", 3, 2) if kind == "folder" else write_bag(tmp_path / "b.mcap", 3, 2)
    messages = played(path)
    counts = Counter(m.topic for m in messages)
    assert counts["loc/left/image_rect"] == counts["loc/right/image_rect"] == counts["ground_truth/odometry"] == 3
    assert counts["nav/left/image_rect"] == counts["nav/pose"] == counts["ground_truth/points"] == 2
    decoded = {(m.topic, m.stamp_ns): TYPESTORE.deserialize_cdr(m.raw, m.msgtype) for m in messages}
    for index in range(3):
        stamp = START_NS + index * 100_000_000
        assert np.array_equal(image_from_message(decoded["loc/left/image_rect", stamp]), loc_pair(index).left)
        assert np.array_equal(image_from_message(decoded["loc/right/image_rect", stamp]), loc_pair(index).right)
        pose = decoded["ground_truth/odometry", stamp].pose.pose
        assert [pose.position.x, pose.position.y, pose.position.z] == true_pose(index).translation.tolist()
    place = decoded["nav/pose", START_NS].pose.position
    assert [place.x, place.y, place.z] == nav_pair(0).T_lm_navsb.translation.tolist()
    infos = (decoded[f"loc/{side}/camera_info", START_NS] for side in ("left", "right"))
    assert rig_from_camera_info(*infos, "loc").same_cameras(LOC_RIG)


@pytest.mark.parametrize("kind", ["folder", "bag"])
def test_camera_info_comes_before_the_images_and_truth_not_after_its_pair(tmp_path: Path, kind: str) -> None:
    path = write_folder(tmp_path / "f", 3, 2) if kind == "folder" else write_bag(tmp_path / "b.mcap", 3, 2)
    order = [(m.topic, m.stamp_ns) for m in played(path)]
    for task in ("loc", "nav"):
        first = order.index((f"{task}/left/image_rect", START_NS))
        assert order.index((f"{task}/left/camera_info", START_NS)) < first
        assert order.index((f"{task}/right/camera_info", START_NS)) < first
    for index in range(3):
        stamp = START_NS + index * 100_000_000
        assert order.index(("ground_truth/odometry", stamp)) < order.index(("loc/left/image_rect", stamp))


@pytest.mark.parametrize("kind", ["folder", "bag"])
def test_the_last_pair_is_the_end(tmp_path: Path, kind: str) -> None:
    path = write_folder(tmp_path / "f", 4, 2) if kind == "folder" else write_bag(tmp_path / "b.mcap", 4, 2)
    assert end_of(open_source(path, {})) == pytest.approx(0.3)


def test_a_bag_passes_on_its_own_bytes_under_other_names(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "b.mcap", 2, 0, jpeg_quality=90)
    plain = {(m.topic, m.stamp_ns): m.raw for m in played(path)}
    assert ("loc/left/image_rect/compressed", START_NS) in plain
    swapped = {
        "loc/left/image_rect/compressed": "loc/right/image_rect/compressed",
        "loc/right/image_rect/compressed": "loc/left/image_rect/compressed",
    }
    other = {(m.topic, m.stamp_ns): m.raw for m in played(path, swapped)}
    key = ("loc/left/image_rect/compressed", START_NS)
    assert other[key] == plain["loc/right/image_rect/compressed", START_NS] != plain[key]


def test_tasks_keep_their_own_clock(tmp_path: Path) -> None:
    for message in played(write_folder(tmp_path / "f", 1, 1)):
        assert message.task == ("nav" if message.topic.startswith(("nav/", "ground_truth/points")) else "loc")
