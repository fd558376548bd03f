"""Pairs that fit their rig: what is handed over in which order, and what is dropped and counted."""

import math
from dataclasses import replace

import pytest
from made_scene import LOC_RIG, START_NS, forged
from rclpy.serialization import deserialize_message
from scenes import raw
from sensor_msgs.msg import CameraInfo, Image

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.stereo_input import StereoInput, StereoInputConfig
from sfr_loc_map.pipeline.reception import MessageTimes

S = 1_000_000_000
OTHER_RIG = replace(LOC_RIG, fx=151.0, fy=151.0)


class Input:
    """A synchroniser whose output is a list of what was called; at first it knows the rig."""

    def __init__(self, depth: int = 3, known: bool = True) -> None:
        self.events: list[object] = []
        self.problems: list[str] = []
        self.inner = StereoInput(
            "loc",
            StereoInputConfig(queue_depth=depth),
            on_pair=lambda pair: self.events.append(pair.stamp_ns - START_NS),
            on_rig=lambda rig: self.events.append(rig.fx),
            on_jump_back=lambda: self.events.append("back"),
            report=self.problems.append,
        )
        if known:
            self.infos(LOC_RIG)
            assert self.events.pop() == 150.0

    def infos(self, rig: StereoRig, *sides: str) -> None:
        for side in sides or SIDES:
            message = raw(bag_messages.camera_info(START_NS, rig, "loc", side))
            self.inner.add_camera_info(side, deserialize_message(message, CameraInfo))

    def pair(self, offset_ns: int, width: int = LOC_RIG.width) -> None:
        for side in SIDES:
            image = Image(header=header_msg(START_NS + offset_ns, ""), width=width, height=LOC_RIG.height)
            self.inner.add_image(side, (image, MessageTimes(None, None)))


def test_only_so_many_pairs_wait_for_camera_info() -> None:
    stereo = Input(depth=3, known=False)
    for index in range(5):
        stereo.pair(index)
    stereo.infos(LOC_RIG)
    assert stereo.events == [150.0, 2, 3, 4]
    assert stereo.inner.dropped["without_camera_info"] == 2
    assert "without a usable camera_info" in stereo.problems[0]


def test_a_rig_is_made_of_one_new_camera_info_of_each_side() -> None:
    stereo = Input()
    stereo.infos(OTHER_RIG, "left")
    assert (stereo.events, stereo.problems) == ([], [])
    stereo.infos(OTHER_RIG, "right")
    stereo.infos(OTHER_RIG)
    assert stereo.events == [151.0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fx": 1e9, "fy": 1e9}, "focal lengths are 1e+09"),
        ({"cy": 1e300}, "principal point"),
        ({"cx": math.nan}, "projection p is empty"),
        ({"baseline_m": 1e9}, "baseline is 1e+09 m"),
    ],
)
def test_an_absurd_rig_is_refused_and_the_present_one_stays(changes: dict[str, float], words: str) -> None:
    stereo = Input()
    stereo.infos(forged(LOC_RIG, **changes))
    assert words in stereo.problems[0]
    stereo.pair(0)
    assert stereo.events == [0]


@pytest.mark.parametrize(
    ("offset_ns", "events", "stale"), [(0, [], 1), (-S + 1, [], 1), (-S, ["back", -S], 0), (1, [1], 0)]
)
def test_a_stamp_that_is_not_later_is_stale_or_a_new_run(offset_ns: int, events: list[object], stale: int) -> None:
    stereo = Input()
    stereo.pair(0)
    assert stereo.inner.is_ahead_of(START_NS + offset_ns) == (offset_ns == -S)
    stereo.pair(offset_ns)
    assert stereo.events[1:] == events
    assert stereo.inner.dropped["stale"] == stale
    stereo.inner.restart()
    stereo.pair(-2 * S)  # after a restart earlier stamps are welcome
    assert stereo.events[-1] == -2 * S


def test_a_pair_of_another_size_is_rejected_and_its_stamp_does_not_count() -> None:
    stereo = Input()
    stereo.pair(5, width=LOC_RIG.width + 1)
    stereo.pair(3)
    assert stereo.events == [3]
    assert stereo.inner.dropped["rejected"] == 1
    assert "its camera_info says 160 x 120" in stereo.problems[0]
