"""Every topic of the nodes' policy and of the description of the interfaces is in the table of topics."""

import xml.etree.ElementTree as ET

from helpers import ROOT
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import RAW, TOPICS, Role, call_topic, names, rectified_beside

OF_ROS = {"/rosout", "/parameter_events", "~/transition_event"}


def test_the_policy_names_topics_of_the_table_and_the_table_no_others() -> None:
    permitted: set[str] = set()
    for profile in ET.parse(ROOT / "config" / "sros2_policy.xml").getroot().iter("profile"):
        for item in profile.iter("topic"):
            permitted.add(str(item.text))
    figures = {"metrics/*"}
    of_tools = {"bookmark", "joint_states"}
    only_if_rectified = {name for name in TOPICS if f"/{RAW}" in name}
    assert permitted - OF_ROS - figures == set(TOPICS) - of_tools - only_if_rectified


def test_the_interfaces_describe_every_topic() -> None:
    text = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8")
    for name in (
        *names(Role.TRUTH, Role.RESULT, recorded=True),
        "initialpose",
        "motion_prior",
        "/tf_static",
        "nav/pose",
        *map(call_topic, Task),
    ):
        assert f"`{name}`" in text or f"`{name}`," in text, name


def test_raw_images_are_replaced_by_rectified_ones() -> None:
    both = ["loc/left/image_rect", "loc/left/image_rect/compressed"]
    assert rectified_beside("loc/left/image_raw") == rectified_beside("loc/left/image_raw/compressed") == both
    assert rectified_beside("loc/left/image_rect") == rectified_beside("nav/pose") == []
