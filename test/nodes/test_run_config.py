"""An `sfr.yaml` as nodes take it: parameters that they declare, topics as remaps."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from helpers.made_scene import compressed_bag
from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.nodes.launch.ros_arguments import arguments_of_config, topic_rules
from sfr_loc_map.nodes.localisation_node import LocalisationNodeConfig
from sfr_loc_map.nodes.mapping_node import MappingNodeConfig
from sfr_loc_map.nodes.monitor_node import MonitorNodeConfig
from sfr_loc_map.source_setup.examination import propose_config
from sfr_loc_map.suite_names import SIDES

pytestmark = pytest.mark.ros
TEXT = """
topics: {loc/left/image_raw: /cam/left/image_raw, loc/right/image_raw: /cam/right/image_raw}
frames: {base: base_link}
extrinsics: {translation_m: [0.3, 0, 0.6], quat_xyzw: [0, 0, 0, 1]}
sync: {stamp_tolerance_s: 0.02}
truth: {source: /gt, lever_arm_m: [0, 0, 0.8], sigma_m: 0.01}
localisation: {max_features: 500}
mapping: {max_range_m: 8.0}
monitor: {publish_period_s: 2.0}
conditions: [distance=2]
limits: limits.yaml
"""


def test_the_nodes_declare_all_that_a_configuration_comes_to(tmp_path: Path) -> None:
    config, written = tmp_path / "sfr.yaml", tmp_path / "parameters.yaml"
    config.write_text(TEXT)
    arguments = arguments_of_config(config, written)
    remaps = dict(word.split(":=") for word in arguments if ":=" in word)
    assert remaps == {
        "loc/left/image_raw": "/cam/left/image_raw",
        "loc/right/image_raw": "/cam/right/image_raw",
        "ground_truth/odometry": "/gt",
    }
    content = yaml.safe_load(written.read_text())
    values = {name.rpartition("/")[2]: node["ros__parameters"] for name, node in content.items()}
    localisation = build(LocalisationNodeConfig, values["localisation_node"])
    assert localisation.T_rb_locsb.transform() is not None
    assert (localisation.rb_frame, localisation.input.rectify) == ("base_link", True)
    assert (localisation.input.stamp_tolerance_s, localisation.localisation.max_features) == (0.02, 500)
    assert build(MappingNodeConfig, values["mapping_node"]).input.rectify is False
    monitor = build(MonitorNodeConfig, values["monitor_node"])
    assert monitor.truth.lever_arm_m == (0, 0, 0.8)
    assert monitor.publish_period_s == 2.0
    assert monitor.score.trajectory.conditions == ("distance=2",)
    assert monitor.limits_file == str(tmp_path / "limits.yaml")


def test_what_nodes_cannot_do_is_said(tmp_path: Path) -> None:
    config = tmp_path / "sfr.yaml"
    config.write_text("calibration: {stereo_layout: side_by_side}\n")
    with pytest.raises(ConfigError, match="apply only to recordings"):
        arguments_of_config(config, tmp_path / "parameters.yaml")


def test_compressed_topics_of_a_recording_reach_the_nodes(tmp_path: Path) -> None:
    bag = compressed_bag(tmp_path, 3)
    proposal = propose_config(bag, Configuration(tmp_path / "sfr.yaml"))
    (tmp_path / "sfr.yaml").write_text(proposal.text())
    loc = open_source(bag, proposal.config).loc
    assert loc is not None
    assert len(list(loc.pairs())) == 3
    wanted = {f"loc/{side}/image_raw/compressed": f"/front/{side}/image_raw/compressed" for side in SIDES}
    old = yaml.safe_dump({"topics": {name.removesuffix("/compressed"): topic for name, topic in wanted.items()}})
    for text in (proposal.text(), old):
        (tmp_path / "sfr.yaml").write_text(text)
        arguments = arguments_of_config(tmp_path / "sfr.yaml", tmp_path / "parameters.yaml")
        remaps = dict(word.split(":=") for word in arguments if ":=" in word)
        assert wanted.items() <= remaps.items()
        nodes = yaml.safe_load((tmp_path / "parameters.yaml").read_text())
        (values,) = (node["ros__parameters"] for name, node in nodes.items() if name.endswith("localisation_node"))
        assert values["input.rectify"] is True


def test_the_page_takes_the_rules_of_topics_in_all_forms_of_ros() -> None:
    """Both words of ROS, and rules of one node, which the page as another node would not apply."""
    taken = {
        "a:=/b": "a:=/b",
        "localisation_node:loc/left:=/eye": "loc/left:=/eye",
        "rostopic://a:=b": "rostopic://a:=b",
    }
    other = ["__ns:=/rover1", "monitor_node:__node:=judge"]
    words = [word for rule in (*taken, *other) for option in ("-r", "--remap") for word in (option, rule)]
    rules = topic_rules(["--ros-args", "--log-level", "info", *words, "-p", "mapping_node:max_range_m:=8.0"])
    assert rules == [rule for rule in taken.values() for _ in range(2)]
