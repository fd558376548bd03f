"""Positions in a source, and the messages of its pairs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.broken_sources import rewritten_bag
from helpers.made_scene import START_NS, nav_pair, true_pose, write_bag, write_folder
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.convert import ConvertOptions, convert
from sfr_loc_map.io.message_stream import Message, messages_of
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.replay.played_pairs import PairTracker, begin_of, between, end_of, pair_of_message, pairs_between


@pytest.mark.parametrize("kind", ["folder", "bag"])
def test_positions_count_from_the_first_message(tmp_path: Path, kind: str) -> None:
    """In a bag that is a camera_info, in files it may be a pose of the truth that begins before the images."""
    folder = write_folder(tmp_path / "f", 3, 0)
    early = Trajectory.from_poses([(START_NS + k * 100_000_000, true_pose(0)) for k in range(-9, 3)])
    save_trajectory(next(folder.rglob("groundtruth.csv")), early)
    source = open_source(folder)
    if kind == "bag":
        convert(source, tmp_path / "b.mcap", ConvertOptions(), lambda done: None)
        source = open_source(tmp_path / "b.mcap")
    before_s = 0.0 if kind == "bag" else 0.9
    assert begin_of(source, source.loc) == START_NS - round(before_s * 1e9)
    assert end_of(source) == pytest.approx(before_s + 0.2)


def message(topic: str, stamp_ns: int) -> Message:
    return Message(topic, "", stamp_ns, b"")


@given(st.lists(st.integers(0, 100), min_size=1, max_size=30), st.floats(0, 12), st.floats(0, 12))
def test_a_part_of_a_source_is_what_lies_between_two_positions_and_the_first_camera_info(
    tenths: list[int], offset_s: float, duration_s: float
) -> None:
    stamps = sorted(10**9 + t * 10**8 for t in tenths)
    whole = [message("loc/left/camera_info", stamps[0])] + [message("loc/left/image_rect", s) for s in stamps]
    end_s = offset_s + duration_s
    rest = list(between(iter(whole), offset_s, end_s))
    assert rest[0] == whole[0]
    assert rest[1:] == [m for m in whole[1:] if offset_s <= (m.stamp_ns - stamps[0]) / NS_PER_S <= end_s]


@pytest.mark.parametrize("late_ns", [0, 3_000_000])
def test_a_pair_is_whole_with_its_last_part_and_has_the_stamp_of_the_left_image(late_ns: int) -> None:
    stamps = range(10**9, 2 * 10**9, 10**8)
    loc = [("loc/left/image_rect", 0), ("loc/right/image_rect/compressed", late_ns)]
    nav = [("nav/right/image_rect", late_ns), ("nav/pose", 0), ("nav/left/image_rect", 0)]
    tracker = PairTracker(
        {
            (topic.removesuffix("/compressed"), stamp_ns + later): (rig, stamp_ns)
            for stamp_ns in stamps
            for rig, parts in (("loc", loc), ("nav", nav))
            for topic, later in parts
        }
    )
    for stamp_ns in stamps:
        added = [tracker.add(Message(topic, "", stamp_ns + later, b"")) for topic, later in loc]
        assert added == [None, ("loc", stamp_ns)]
        added = [tracker.add(Message(topic, "", stamp_ns + later, b"")) for topic, later in nav]
        assert added == [None, None, ("nav", stamp_ns)]
        assert tracker.add(Message("ground_truth/odometry", "", stamp_ns, b"")) is None


@pytest.mark.parametrize("kind", ["folder", "bag", "compressed bag"])
def test_the_pairs_that_a_replay_awaits_are_those_of_the_source(tmp_path: Path, kind: str) -> None:
    if kind == "folder":
        path = write_folder(tmp_path / "f", 3, 2)
    else:
        path = write_bag(tmp_path / "b.mcap", 3, 2, jpeg_quality=90 if kind == "compressed bag" else None)
    source = open_source(path)
    assert (source.recorded is None) is (kind == "folder")
    tracker = PairTracker(pair_of_message(source))
    completed = [pair for pair in map(tracker.add, messages_of(source)) if pair is not None]
    assert source.loc is not None
    assert source.nav is not None
    expected = [("loc", stamp_ns) for stamp_ns in source.loc.stamps_ns]
    expected += [("nav", stamp_ns) for stamp_ns in source.nav.stamps_ns]
    assert sorted(completed) == sorted(expected)
    for begin_s, end_s in ((0.0, np.inf), (0.0, 0.1), (0.05, 0.25)):
        tracker = PairTracker(pair_of_message(source))
        played = [tracker.add(each) for each in between(messages_of(source), begin_s, end_s)]
        assert pairs_between(source, begin_s, end_s) == len(played) - played.count(None)


def test_the_parts_of_a_recorded_pair_have_their_own_stamps_and_one_without_a_pose_is_absent(tmp_path: Path) -> None:
    late_ns = 3_000_000

    def change(topic: str, number: int, message: Any) -> Any:
        if topic.endswith("nav/right/image_rect"):
            message.header.stamp.nanosec += late_ns
        return None if topic.endswith("nav/pose") and number == 1 else message

    path = rewritten_bag(tmp_path / "changed.mcap", change)
    pair_of = pair_of_message(open_source(path))
    stamp_ns = nav_pair(0).pair.stamp_ns
    assert {message: pair for message, pair in pair_of.items() if pair[0] == "nav"} == {
        ("nav/left/image_rect", stamp_ns): ("nav", stamp_ns),
        ("nav/right/image_rect", stamp_ns + late_ns): ("nav", stamp_ns),
        ("nav/pose", stamp_ns): ("nav", stamp_ns),
    }
