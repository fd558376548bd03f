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

S, SMALL = 1_000_000_000, "a pair of another size"
OTHER_RIG = replace(LOC_RIG, fx=151.0, fy=151.0)


def made() -> tuple[list[object], list[str], StereoInput]:
    events: list[object] = []
    problems: list[str] = []
    stereo = StereoInput(
        "loc",
        StereoInputConfig(queue_depth=3),
        on_pair=lambda pair: events.append(pair.stamp_ns - START_NS),
        on_rig=lambda rig: events.append(rig.fx),
        on_jump_back=lambda: events.append("back"),
        report=problems.append,
    )
    return events, problems, stereo


def inform(stereo: StereoInput, rig: StereoRig, side: str) -> None:
    message = raw(bag_messages.camera_info(START_NS, rig, "loc", side))
    stereo.add_camera_info(side, deserialize_message(message, CameraInfo))


def send(stereo: StereoInput, offset_ns: int, width: int = LOC_RIG.width) -> None:
    for side in SIDES:
        image = Image(header=header_msg(START_NS + offset_ns, ""), width=width, height=LOC_RIG.height)
        stereo.add_image(side, (image, MessageTimes(None, None)))


@pytest.mark.parametrize(
    ("inputs", "events", "dropped"),
    [
        ([0, 1, 2, 3, 4, LOC_RIG], [150.0, 2, 3, 4], {"without_camera_info": 2}),  # so many wait
        ([LOC_RIG, LOC_RIG, OTHER_RIG, OTHER_RIG], [150.0, 151.0], {}),
        ([LOC_RIG, 0, 1], [150.0, 0, 1], {}),
        ([LOC_RIG, 0, 0], [150.0, 0], {"stale": 1}),
        ([LOC_RIG, 0, -S + 1], [150.0, 0], {"stale": 1}),
        ([LOC_RIG, 0, -S, 1 - S], [150.0, 0, "back", -S, 1 - S], {}),
        ([LOC_RIG, SMALL, 3], [150.0, 3], {"rejected": 1}),  # its stamp does not count
    ],
)
def test_pairs_are_handed_over_in_order_or_counted(
    inputs: list[StereoRig | int | str], events: list[object], dropped: dict[str, int]
) -> None:
    found, problems, stereo = made()
    for item in inputs:
        if isinstance(item, StereoRig):
            for side in SIDES:
                inform(stereo, item, side)
        else:
            send(stereo, *((5, LOC_RIG.width + 1) if item is SMALL else (item,)))
    assert found == events
    assert {cause: count for cause, count in stereo.dropped.items() if count} == dropped
    assert bool(problems) == bool(dropped.keys() - {"stale"})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fx": 1e9, "fy": 1e9}, "focal lengths are 1e+09"),
        ({"cy": 1e300}, "principal point"),
        ({"cx": math.nan}, "projection p is empty"),
        ({"baseline_m": 1e9}, "baseline is 1e+09 m"),
    ],
)
def test_an_absurd_rig_is_refused_and_half_a_new_one_is_none(changes: dict[str, float], words: str) -> None:
    events, problems, stereo = made()
    for rig, side in ((LOC_RIG, "left"), (LOC_RIG, "right"), (forged(LOC_RIG, **changes), "left")):
        inform(stereo, rig, side)
    assert (events, problems) == ([150.0], [])
    inform(stereo, forged(LOC_RIG, **changes), "right")
    assert words in problems[0]
    send(stereo, 0)
    assert events == [150.0, 0]
