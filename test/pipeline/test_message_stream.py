"""A source as messages, paced and controlled."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_scene import LOC_RIG, START_NS, loc_pair, nav_pair, true_pose, write_bag, write_folder

from sfr_loc_map.io.bag import TYPESTORE
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import image_from_message
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.pipeline.controls import Controls
from sfr_loc_map.pipeline.message_stream import Message, Pacer, PairTracker, messages_of, start_at, topics_of


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
    # camera_info comes before the images, and the truth not after its pair
    order = [(m.topic, m.stamp_ns) for m in messages]
    for task in ("loc", "nav"):
        first = order.index((f"{task}/left/image_rect", START_NS))
        assert order.index((f"{task}/left/camera_info", START_NS)) < first
        assert order.index((f"{task}/right/camera_info", START_NS)) < first
    for index in range(3):
        stamp = START_NS + index * 100_000_000
        assert order.index(("ground_truth/odometry", stamp)) < order.index(("loc/left/image_rect", stamp))


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


def message(topic: str, stamp_ns: int) -> Message:
    return Message(topic, "", stamp_ns, b"")


class FakeClock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_messages_are_due_by_their_stamps_each_task_from_its_own_first() -> None:
    clock, controls = FakeClock(), Controls(rate=2.0)
    pacer = Pacer(controls, clock)
    assert pacer.wait_s(message("loc/left/image_rect", 5_000_000_000)) == 0
    assert pacer.wait_s(message("loc/left/image_rect", 6_000_000_000)) == pytest.approx(0.5)
    clock.now += 0.4
    assert pacer.wait_s(message("loc/left/image_rect", 6_000_000_000)) == pytest.approx(0.1)
    assert pacer.wait_s(message("nav/left/image_rect", 99)) == 0


def test_after_a_pause_a_step_or_another_rate_the_next_message_is_due_at_once() -> None:
    clock, controls = FakeClock(), Controls(rate=1.0)
    pacer = Pacer(controls, clock)
    pacer.wait_s(message("loc/x", 0))
    controls.pause()
    pacer.wait_s(message("loc/x", 10**10))
    controls.resume()
    assert pacer.wait_s(message("loc/x", 10**10)) == 0
    assert pacer.wait_s(message("loc/x", 2 * 10**10)) == 10
    controls.rate = 10.0
    assert pacer.wait_s(message("loc/x", 2 * 10**10)) == 0
    assert pacer.wait_s(message("loc/x", 3 * 10**10)) == 1
    controls.step()
    assert pacer.wait_s(message("loc/x", 3 * 10**10)) == 0
    assert not controls.held


def test_keys() -> None:
    controls = Controls(rate=1.0, position_s=7.0)
    controls.key(" ")
    assert controls.held
    controls.key("right")
    controls.key("s")
    assert controls.steps == 2
    controls.key(" ")
    assert (controls.paused, controls.steps) == (False, 0)
    controls.key("left")
    assert controls.seek_s == 2.0
    controls.position_s = 3.0
    controls.key("left")
    assert controls.seek_s == 0.0
    controls.key("f")
    assert controls.seek_s == 8.0
    controls.key("up")
    assert controls.rate == pytest.approx(1.1)
    controls.key("down")
    controls.key("l")
    assert controls.rate == pytest.approx(1.0)
    assert controls.loop
    controls.key("?")
    assert not controls.stopped
    controls.key("q")
    assert controls.stopped
    assert controls.interrupted


def test_a_pair_is_complete_with_both_images_and_for_mapping_its_pose() -> None:
    pairs = PairTracker()
    assert pairs.add(message("loc/left/camera_info", 1)) is None
    assert pairs.add(message("loc/left/image_rect", 1)) is None
    assert pairs.add(message("loc/right/image_rect", 2)) is None
    assert pairs.add(message("loc/right/image_rect/compressed", 1)) == ("loc", 1)
    for topic in ("nav/pose", "nav/right/image_rect"):
        assert pairs.add(message(topic, 1)) is None
    assert pairs.add(message("nav/left/image_rect", 1)) == ("nav", 1)


@given(st.lists(st.integers(0, 100), min_size=1, max_size=30), st.floats(0, 12))
def test_from_a_position_on_comes_what_is_not_before_it_and_the_first_camera_info(
    tenths: list[int], offset_s: float
) -> None:
    stamps = sorted(10**9 + t * 10**8 for t in tenths)
    whole = [message("loc/left/camera_info", stamps[0])] + [message("loc/left/image_rect", s) for s in stamps]
    positions: list[float] = []
    rest = list(start_at(iter(whole), offset_s, positions.append))
    assert rest[0] == whole[0]
    assert rest[1:] == [m for m in whole[1:] if (m.stamp_ns - stamps[0]) * 1e-9 >= offset_s]
    assert all(t >= offset_s for t in positions)


def test_nothing_is_sought_after_the_last_pair() -> None:
    controls = Controls(end_s=12.0, position_s=9.0)
    controls.key("f")  # 5 s on
    controls.seek(12.1)
    assert controls.seek_s is None
    controls.seek(12.0)
    assert controls.next_start_s() == 12.0
