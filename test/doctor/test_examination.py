"""Findings on observations that are made in memory."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from sfr_loc_map.doctor.examination import examine
from sfr_loc_map.doctor.observation import EXPECTED, RIG_OF_NODE, Observation, ObservedNode, ObservedTopic, SourceKind
from sfr_loc_map.message_types import IMAGE


def test_a_node_without_its_cameras_waits() -> None:
    """A plain `sfr run` on a rover without mapping cameras is no fault."""
    nodes = tuple(ObservedNode(name, rig, extrinsics_given=True) for name, rig in RIG_OF_NODE.items())
    topics = {
        f"loc/{side}/{what}": ObservedTopic(f"/loc/{side}/{what}", EXPECTED[f"loc/{side}/{what}"])
        for side in ("left", "right")
        for what in ("image_rect", "camera_info")
    }
    unheard = {
        "nav/left/image_rect": ObservedTopic("/nav/left/image_rect", (IMAGE,), publishers=())
    }  # of the subscriber
    findings = examine(Observation("", SourceKind.GRAPH, topics=topics | unheard, nodes=nodes))
    assert [(item.where, item.is_blocking) for item in findings if "wait" in item.text] == [("mapping_node", False)]
    assert not [item for item in findings if "nav/" in item.where]
    alone = examine(Observation("", SourceKind.GRAPH, topics=unheard, nodes=nodes))
    assert {item.where for item in alone if item.is_blocking} >= {"/nav/left/image_rect", "loc/left/image_rect"}


def test_images_of_which_none_has_a_stamp_are_no_fault() -> None:
    sides = [f"loc/{side}/image_rect" for side in ("left", "right")]
    header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=1), frame_id="")
    broken = SimpleNamespace(header=header, data=b"", format="jpeg")
    for stamps in (((), ()), ((1, 2), ()), ((), (1, 2))):
        topics = {
            name: ObservedTopic(name, (IMAGE,), stamps_ns=np.array(found, np.int64), messages=(broken,))
            for name, found in zip(sides, stamps, strict=True)
        }
        for kind in (SourceKind.BAG, SourceKind.GRAPH):
            assert "pair" not in {finding.cause.value for finding in examine(Observation("", kind, topics=topics))}
