"""Pairs that fit their rig: what is handed over in which order, and what is dropped and counted."""

from dataclasses import replace

import pytest
from made_scene import LOC_RIG, START_NS
from rclpy.serialization import deserialize_message
from scenes import raw
from sensor_msgs.msg import CameraInfo, Image

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes.messages import header_msg
from sfr_loc_map.nodes.pair_node import StereoInput, StereoInputConfig
from sfr_loc_map.pipeline.reception import MessageTimes

S, SMALL = 1_000_000_000, "a pair of another size"
OTHER_RIG = replace(LOC_RIG, fx=151.0, fy=151.0)


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
    found: list[object] = []
    problems: list[str] = []
    stereo = StereoInput(
        "loc",
        StereoInputConfig(queue_depth=3),
        on_pair=lambda pair: found.append(pair.stamp_ns - START_NS),
        on_rig=lambda rig: found.append(rig.fx),
        on_jump_back=lambda: found.append("back"),
        report=problems.append,
    )
    for item in inputs:
        offset_ns, width = (5, LOC_RIG.width + 1) if item is SMALL else (item, LOC_RIG.width)
        for side in SIDES:
            if isinstance(item, StereoRig):
                message = raw(bag_messages.camera_info(START_NS, item, "loc", side))
                stereo.add_camera_info(side, deserialize_message(message, CameraInfo))
            else:
                image = Image(header=header_msg(START_NS + offset_ns, ""), width=width, height=LOC_RIG.height)
                stereo.add_image(side, (image, MessageTimes(None, None)))
    assert found == events
    assert {cause: count for cause, count in stereo.dropped.items() if count} == dropped
    assert bool(problems) == bool(dropped.keys() - {"stale"})
