"""Issues of observations that are made in memory."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sfr_loc_map.doctor.examination import examine
from sfr_loc_map.doctor.observation import EXPECTED, RIG_OF_NODE, Observation, ObservedNode, ObservedTopic, SourceKind
from sfr_loc_map.errors import InputError
from sfr_loc_map.message_types import IMAGE
from sfr_loc_map.transport_issues import Publisher, Reliability


def test_a_node_without_its_cameras_waits() -> None:
    """A plain `sfr run` on a rover without mapping cameras is not a fault."""
    nodes = tuple(ObservedNode(name, rig, extrinsics_given=True) for name, rig in RIG_OF_NODE.items())
    topics = {
        f"loc/{side}/{what}": ObservedTopic(f"/loc/{side}/{what}", EXPECTED[f"loc/{side}/{what}"])
        for side in ("left", "right")
        for what in ("image_rect", "camera_info")
    }
    unheard = {
        "nav/left/image_rect": ObservedTopic("/nav/left/image_rect", (IMAGE,), publishers=())
    }  # of the subscriber
    issues = examine(Observation("", SourceKind.GRAPH, topics=topics | unheard, nodes=nodes))
    assert [(item.where, item.is_blocking) for item in issues if "wait" in item.text] == [("mapping_node", False)]
    assert not [item for item in issues if "nav/" in item.where]
    alone = examine(Observation("", SourceKind.GRAPH, topics=unheard, nodes=nodes))
    assert {item.where for item in alone if item.is_blocking} >= {"/nav/left/image_rect", "loc/left/image_rect"}


def test_two_publishers_of_images_are_reported() -> None:
    publishers = (Publisher("/camera", IMAGE), Publisher("/player", IMAGE))
    for count in (1, 2):
        images = ObservedTopic("/eye", (IMAGE,), publishers[:count])
        issues = examine(Observation("", SourceKind.GRAPH, topics={"loc/left/image_rect": images}))
        found = [(item.where, item.text) for item in issues if item.cause == "several_publishers"]
        assert found == [("/eye", "2 publishers (/camera, /player)")][: count - 1]


def test_ground_truth_that_a_node_does_not_receive_is_blocking() -> None:
    for name, rig in (("ground_truth/points", "nav"), ("ground_truth/odometry", "loc")):
        (msgtype, *_) = EXPECTED[name]
        for offered, is_received in ((Reliability.BEST_EFFORT, False), (Reliability.RELIABLE, True)):
            publishers = (Publisher("/driver", msgtype, offered),)
            requests = {"metrics_monitor": Reliability.RELIABLE}
            truth = ObservedTopic(f"/{name}", (msgtype,), publishers, np.array([1]), requests=requests)
            images = ObservedTopic("x", (IMAGE,), (Publisher("/driver", IMAGE),))
            seen = Observation("", SourceKind.GRAPH, topics={name: truth, f"{rig}/left/image_rect": images})
            found = [item for item in examine(seen) if item.where == f"/{name}"]
            assert [(item.cause, item.is_blocking) for item in found] == [("qos", True)][: not is_received]
            assert all(f"qos_overrides./{name}.subscription.reliability" in item.fix for item in found)


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
            assert "pair" not in {issue.cause.value for issue in examine(Observation("", kind, topics=topics))}


def test_the_finding_of_a_camera_has_the_problem_and_its_fix() -> None:
    """The fix of an error follows its last colon, even if the problem contains one."""
    numbers = {"k": (100.0, 0.0, 32.0, 0.0, 100.0, 24.0, 0.0, 0.0, 1.0), "d": (), "r": (2.0, *[0.0] * 8)}
    p = (100.0, 0.0, 32.0, -10.0, 0.0, 100.0, 24.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    info = SimpleNamespace(width=64, height=48, distortion_model="", p=p, binning_x=0, binning_y=0, **numbers)
    info.roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    image = SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=1), frame_id=""), data=b"")
    kinds = {"image_raw": image, "camera_info": info}
    topics = {
        f"loc/{side}/{kind}": ObservedTopic(
            f"loc/{side}/{kind}", EXPECTED[f"loc/{side}/{kind}"], stamps_ns=np.array([1]), messages=(message,)
        )
        for side in ("left", "right")
        for kind, message in kinds.items()
    }
    (found,) = [item for item in examine(Observation("", SourceKind.BAG, topics=topics)) if item.cause == "camera_info"]
    assert found.text.startswith("loc/left/camera_info: r is not a rotation: ")
    assert found.fix == "calibrate the pair"


def test_stamps_are_compared_within_the_tolerance_of_the_node_or_of_the_configuration() -> None:
    stamps_ns = np.arange(1, 30, dtype=np.int64) * 200_000_000
    message = SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=1), frame_id=""), data=b"")
    late_ns = {"nav/left/image_rect": 0, "nav/right/image_rect": 15_000_000, "nav/pose": 15_000_000}
    topics = {
        name: ObservedTopic(name, EXPECTED[name], stamps_ns=stamps_ns + late, messages=(message,))
        for name, late in late_ns.items()
    }

    def causes(configured_ns: int, of_node_ns: int | None = None, *, has_node: bool = False) -> set[str]:
        node = ObservedNode("mapping_node", "nav", stamp_tolerance_ns=of_node_ns)
        seen = Observation("", topics=topics, nodes=(node,) * has_node, stamp_tolerance_ns=configured_ns)
        return {issue.cause.value for issue in examine(seen)} & {"unsynchronised", "pose_stamps"}

    assert causes(10_000_000) == {"unsynchronised", "pose_stamps"}
    assert not causes(20_000_000)
    assert not causes(10_000_000, 20_000_000, has_node=True)
    assert causes(20_000_000, 10_000_000, has_node=True) == {"unsynchronised", "pose_stamps"}
    assert not causes(20_000_000, None, has_node=True)  # the node does not answer


@pytest.mark.parametrize(
    ("error", "text", "fix"),
    [
        (
            InputError("bag 'x' has no topic 'a': the topics are /b;", "correct this name"),
            "it has no topic 'a': the topics are /b",
            "correct this name",
        ),
        (InputError("bag 'x': no stamps:", "run sfr info x"), "no stamps", "run sfr info x"),
        (InputError("bag 'x': a loop: a > b > a;", "record it again"), "a loop: a > b > a", "record it again"),
        (InputError("bag 'x' is empty"), "it is empty", "correct, record or copy it again"),
    ],
)
def test_the_fix_of_an_unreadable_source_is_the_advice_of_its_error(error: InputError, text: str, fix: str) -> None:
    """The name of the source is not repeated in the text."""
    for subject in ("bag 'x'", "'x'"):
        (issue,) = examine(Observation(subject, broken=error))
        assert (issue.where, issue.text, issue.fix) == (subject, text, fix)
