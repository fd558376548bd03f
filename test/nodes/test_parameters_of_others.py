"""One parameter file for all nodes of a robot: names of other nodes are ignored, misspelt own ones refused."""

import re
from pathlib import Path

import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.mapping_node import MappingNode
from sfr_loc_map.nodes.monitor_node import MonitorNode

SHARED = """
/**:
  ros__parameters:
    robot_model: rover
    wheel: {radius_m: 0.2, names: ["a", "b"]}
    health: {period_s: 0.5}
    localisation: {max_features: 300}
    mapping: {min_range_m: 1.5}
    score: {trajectory: {spacing: 7}}
    input: {queue_depth: 40, reliability: reliable, rectify: true}
"""


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (LocalisationNode, "localisation.max_features", 300),
        (LocalisationNode, "input.queue_depth", 40),
        (MappingNode, "mapping.min_range_m", 1.5),
        (MonitorNode, "score.trajectory.spacing", 7),
        (MonitorNode, "input.reliability", "reliable"),
    ],
)
def test_each_node_takes_its_own_parameters(
    ros: None, tmp_path: Path, kind: type[ManagedNode], name: str, value: object
) -> None:
    (tmp_path / "all.yaml").write_text(SHARED, encoding="utf-8")
    arguments = ["--ros-args", "--params-file", str(tmp_path / "all.yaml")]
    node = kind(cli_args=arguments, use_global_arguments=False)
    assert node.get_parameter(name).value == value
    assert node.get_parameter("health.period_s").value == 0.5
    assert not node.has_parameter("robot_model")
    node.destroy_node()


@pytest.mark.parametrize(
    ("argument", "meant"),
    [
        ("queue_siz:=3", "queue_size"),
        ("publishtf:=false", "publish_tf"),
        ("input.depth:=3", "input."),
        ("localisation.motion.max_turn:=1.0", "localisation.motion."),
    ],
)
def test_a_misspelt_name_of_the_node_is_refused(ros: None, argument: str, meant: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"unknown key '{argument.partition(':')[0]}'")) as refused:
        LocalisationNode(cli_args=["--ros-args", "-p", argument], use_global_arguments=False)
    assert meant in str(refused.value)
