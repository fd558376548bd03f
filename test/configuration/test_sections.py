"""An `sfr.yaml` and a ROS parameter file give the same sections; ambiguous and malformed files are refused."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig


def sections_of(path: Path) -> Mapping[str, Any]:
    return Configuration.read(path).sections


OF_ALL = "/**:\n  ros__parameters: {truth.sigma_m: 0.1}\n"
OF_MAPPER = "mapping_node:\n  ros__parameters: {input.stamp_tolerance_s: 0.2}\n"
OF_MONITOR = "monitor_node:\n  ros__parameters: {truth: {sigma_m: 0.2}}\n"


@pytest.mark.parametrize(
    ("text", "sections"),
    [
        ("/**:\n  ros__parameters:\n", {}),
        (OF_ALL + OF_MONITOR, {"truth": {"sigma_m": 0.2}}),
        (OF_MONITOR + OF_ALL, {"truth": {"sigma_m": 0.2}}),
        (OF_MONITOR.replace("monitor", "other") + OF_ALL, {"truth": {"sigma_m": 0.1}}),
        (OF_ALL.replace("/**", "/*"), {"truth": {"sigma_m": 0.1}}),
        (
            OF_ALL.replace("truth.sigma_m", "mapping.voxel_m").replace("/**", "/rover/**") + OF_ALL,
            {"mapping": {"voxel_m": 0.1}, "truth": {"sigma_m": 0.1}},
        ),
        (OF_MAPPER, {"sync": {"stamp_tolerance_s": 0.2}}),
    ],
    ids=["empty", "of a node", "of all nodes, below", "of another node", "one token", "two wildcards", "of the mapper"],
)
def test_parameters_of_nodes_are_read_from_a_ros_parameter_file(
    tmp_path: Path, text: str, sections: dict[str, Any]
) -> None:
    (tmp_path / "nodes.yaml").write_text(text)
    assert sections_of(tmp_path / "nodes.yaml") == sections


@pytest.mark.parametrize("node", ["/**", "/**/localisation_node", "localisation_node"])
def test_a_misspelt_prefix_in_a_ros_parameter_file_is_refused(tmp_path: Path, node: str) -> None:
    (tmp_path / "nodes.yaml").write_text(f"{node}:\n  ros__parameters: {{localization: {{max_features: 300}}}}\n")
    with pytest.raises(
        ConfigError, match=r"unknown parameter 'localization\.max_features' .*did you mean 'localisation'"
    ):
        sections_of(tmp_path / "nodes.yaml")


@pytest.mark.parametrize("node", ["localisation", "mapping", "monitor"])
def test_the_parameter_files_of_the_package_are_read(node: str) -> None:
    given = Configuration.read(Path(__file__).parents[2] / "config" / f"{node}.yaml")
    for config_type in (LocalisationConfig, MappingConfig):
        assert given.build(config_type, config_type.__module__.split(".")[1]) == config_type()


def test_a_parameter_of_a_node_without_its_prefix_is_refused(tmp_path: Path) -> None:
    (tmp_path / "nodes.yaml").write_text("/localisation_node: {ros__parameters: {max_features: 3, ds_frame: map}}\n")
    given = Configuration.read(tmp_path / "nodes.yaml")
    with pytest.raises(ConfigError, match=r"unknown parameter 'max_features' .* 'localisation\.max_features'"):
        given.build(LocalisationConfig, "localisation")
    given.build(MappingConfig, "mapping")


def test_other_parameters_of_nodes_are_ignored(tmp_path: Path) -> None:
    text = OF_ALL.replace("truth.sigma_m", "autostart")
    other = OF_MONITOR.replace("monitor", "other").replace("truth", "thruth")
    (tmp_path / "nodes.yaml").write_text(text + other)
    assert sections_of(tmp_path / "nodes.yaml") == {}


def test_values_of_a_node_have_priority_over_those_of_all_nodes_in_any_order(tmp_path: Path) -> None:
    (tmp_path / "nodes.yaml").write_text(OF_MONITOR.replace("monitor", "/**/monitor") + OF_ALL)
    assert sections_of(tmp_path / "nodes.yaml") == {"truth": {"sigma_m": 0.2}}


@pytest.mark.parametrize("node", ["/rover/monitor_node", "rover/monitor_node", "monitor_node"])
def test_nodes_of_a_namespace_are_read(tmp_path: Path, node: str) -> None:
    nested = "rover:\n  monitor_node:\n    ros__parameters: {truth.sigma_m: 0.2}\n"
    for text in (OF_MONITOR.replace("monitor_node", node), nested):
        (tmp_path / "nodes.yaml").write_text(text)
        assert sections_of(tmp_path / "nodes.yaml") == {"truth": {"sigma_m": 0.2}}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (OF_MONITOR + "sync: {stamps: record}\n", "'sync.stamps' is not in ros__parameters"),
        (OF_MONITOR.replace("monitor", "montor"), "unknown node 'montor_node' .*did you mean 'monitor_node'"),
        (OF_MONITOR.replace("monitor", "/a/monitor") + OF_MONITOR, "'/a/monitor_node' and 'monitor_node' are nodes of"),
        ("T_rb_locsb: {translation_m: [0, 0, 1]}\nextrinsics: {quat_xyzw: [0, 0, 0, 1]}\n", ".* are names of one"),
        ("truth.source: a\ntruth: {source: b}\n", "'truth.source' is given twice"),
        ("truth.source: a\nlimits: {a: 1}\n", "'limits.a' is 1"),
        ("limits: 0\n", "'limits' is 0"),
        ("conditions: [5]\n", "'conditions' is"),
        ("conditions: distance=5\n", "'conditions' is"),
        ("sync: 0\n", "'sync' is 0"),
        ("localistaion: {}\n", "unknown section 'localistaion' .did you mean 'localisation'"),
        ("limits: {a: {}}\n", "'limits.a' is {}"),
        ("localisation_node: {ros__parameters: {localistaion: {}}}\n", "unknown parameter 'localistaion'"),
        (OF_ALL.replace("/**", "/rover/**") + OF_ALL, "'truth.sigma_m' is given by '/\\*\\*' and by another name"),
        (OF_ALL.replace("/**", "/mapping*"), "'/mapping\\*' is not a name of nodes"),
        (
            OF_MAPPER + OF_MAPPER.replace("mapping", "localisation").replace("0.2", "0.1"),
            "'input.stamp_tolerance_s' is",
        ),
        ("/**: {ros__parameters: {frames: {base: x}}}\n", "'frames' of '\\*\\*' is a section of sfr.yaml"),
        ("/**: {ros__parameters: {extrinsics.quat_xyzw: [0]}}\n", "'extrinsics' .*: name it 'T_rb_locsb'"),
        (
            OF_MAPPER.replace("input", "localisation"),
            "'localisation.stamp_tolerance_s' of 'mapping_node' is a parameter",
        ),
        ("/**: {ros__parameters: {localisation: 5}}\n", "'localisation' is 5: a mapping"),
        ("/**: {ros__parameters: 5}\n", "'/\\*\\*.ros__parameters' is 5: a mapping"),
    ],
)
def test_an_ambiguous_or_malformed_file_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "file.yaml").write_text(text)
    with pytest.raises(ConfigError, match=rf"file\.yaml: {words}"):
        sections_of(tmp_path / "file.yaml")


@pytest.mark.parametrize("empty", ["{}", "{ros__parameters: {}}", "{ros__parameters: {localisation: }}"])
def test_nodes_without_parameters_are_accepted(tmp_path: Path, empty: str) -> None:
    text = f"localisation_node: {empty}\nmonitor_node: {{ros__parameters: {{truth.source: a}}}}\n"
    (tmp_path / "nodes.yaml").write_text(text)
    assert sections_of(tmp_path / "nodes.yaml") == {"truth": {"source": "a"}}


def test_other_nodes_with_similar_names_are_ignored(tmp_path: Path) -> None:
    text = (
        "localization_node: {ros__parameters: {map_frame: x}}\nslam_mapping_node: {ros__parameters: {mapping.m: 1}}\n"
    )
    (tmp_path / "nodes.yaml").write_text(text + "/**: {ros__parameters: {use_sim_time: true}}\n")
    assert sections_of(tmp_path / "nodes.yaml") == {}


@pytest.mark.parametrize(
    "text",
    [
        "my_localiser: {ros__parameters: {localisation: {max_features: 300}}}\n",
        "/rover/amcl: {ros__parameters: {max_particles: 300}}\nmap_server: {ros__parameters: {topic_name: map}}\n",
        OF_MONITOR.replace("monitor", "other"),
    ],
)
def test_a_file_with_parameters_of_other_nodes_alone_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "nodes.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"nodes\.yaml: all parameters are those of other nodes, such as '"):
        sections_of(tmp_path / "nodes.yaml")


@pytest.mark.parametrize("name", ["thruth", "topic", "ground_truth", "camera", "max_features", "/**.ros__params"])
def test_an_unknown_section_is_refused_also_if_it_is_the_only_one(tmp_path: Path, name: str) -> None:
    (tmp_path / "sfr.yaml").write_text(f"{name}: {{file: x}}\n")
    with pytest.raises(ConfigError, match=r"sfr\.yaml: unknown section '"):
        sections_of(tmp_path / "sfr.yaml")


def test_parameters_beside_a_section_are_refused(tmp_path: Path) -> None:
    (tmp_path / "sfr.yaml").write_text("localisation: {min_inliers: 20}\nmax_features: 300\n")
    with pytest.raises(ConfigError, match=r"sfr\.yaml: unknown section 'max_features'"):
        sections_of(tmp_path / "sfr.yaml")


def test_an_empty_section_does_not_remove_its_values(tmp_path: Path) -> None:
    (tmp_path / "sfr.yaml").write_text("truth.source: a\ntruth:\nlimits:\nmapping: {}\n")
    assert sections_of(tmp_path / "sfr.yaml") == {"truth": {"source": "a"}}
