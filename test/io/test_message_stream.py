"""A source as messages, from any position on, each due by its stamp."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from helpers.made_scene import LOC_RIG, START_NS, loc_pair, nav_pair, true_pose, write_bag, write_folder
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.faults.source import faulty
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.calibration.rectification import rig_of_infos
from sfr_loc_map.io.image_codec import samples_of
from sfr_loc_map.io.message_stream import Message, messages_of, topics_of
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.suite_names import SIDES


def played(path: Path, topics: dict[str, str] | None = None) -> dict[tuple[str, int], Message]:
    """Return the messages of a source in their order, by topic and stamp."""
    source = open_source(path, SourceConfig(topics=topics or {}))
    messages = list(messages_of(source))
    assert {m.topic: m.msgtype for m in messages} == topics_of(source)
    return {(m.topic, m.stamp_ns): m for m in messages}


@pytest.mark.parametrize("kind", ["folder", "bag"])
def test_all_messages_of_a_source_come_whole_and_in_order(tmp_path: Path, kind: str) -> None:
    messages = played(write_folder(tmp_path / "f", 3, 2) if kind == "folder" else write_bag(tmp_path / "b.mcap", 3, 2))
    counts = Counter(topic for topic, _ in messages)
    assert counts["loc/left/image_rect"] == counts["loc/right/image_rect"] == counts["ground_truth/odometry"] == 3
    assert counts["nav/left/image_rect"] == counts["nav/pose"] == counts["ground_truth/points"] == 2
    decoded = {key: TYPESTORE.deserialize_cdr(item.raw, item.msgtype) for key, item in messages.items()}
    order = list(messages)
    for index in range(3):
        stamp = START_NS + index * 100_000_000
        for side in SIDES:
            image = samples_of(decoded[f"loc/{side}/image_rect", stamp]).grey()
            assert np.array_equal(image, getattr(loc_pair(index), side))
        position = decoded["ground_truth/odometry", stamp].pose.pose.position
        assert [position.x, position.y, position.z] == true_pose(index).translation.tolist()
        assert order.index(("ground_truth/odometry", stamp)) < order.index(("loc/left/image_rect", stamp))
    position = decoded["nav/pose", START_NS].pose.position
    assert [position.x, position.y, position.z] == nav_pair(0).T_lm_navsb.translation.tolist()
    infos = (decoded[f"loc/{side}/camera_info", START_NS] for side in SIDES)
    assert rig_of_infos(infos, "loc", raw=False)[0].same_cameras(LOC_RIG)
    for task in ("loc", "nav"):
        first = order.index((f"{task}/left/image_rect", START_NS))
        assert all(order.index((f"{task}/{side}/camera_info", START_NS)) < first for side in SIDES)


def test_a_bag_with_injected_faults_is_played_with_them(tmp_path: Path) -> None:
    source = open_source(write_bag(tmp_path / "b.mcap", 4, 0))
    changed = faulty(source, [parse_fault("dropped:share=0.5"), parse_fault("noisy:share=1,start=0")], seed=1)
    assert (changed.format, changed.config) == (source.format, source.config)
    images = [item for item in messages_of(changed) if item.topic == "loc/left/image_rect"]
    assert [item.stamp_ns for item in images] == list(changed.loc.stamps_ns)
    assert len(images) == 2
    for item, pair in zip(images, changed.loc.pairs(), strict=True):
        played = samples_of(TYPESTORE.deserialize_cdr(item.raw, item.msgtype)).grey()
        np.testing.assert_array_equal(played, pair.left)
