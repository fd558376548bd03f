"""Parameters are declared once, checked, flattened and rebuilt without a difference."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, make_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.config import build, flatten, param, parameters
from sfr_loc_map.config_file import Configuration
from sfr_loc_map.config_yaml import load_yaml, yaml_text
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.simulation.config import SimulationConfig


@dataclass(frozen=True, slots=True)
class Matcher:
    max_disparity: int = param(64, unit="px", doc="Largest disparity.", low=1, high=256)
    method: str = param("blocks", doc="Way of matching.", choices=("blocks", "pixels"))


@dataclass(frozen=True, slots=True)
class Whole:
    voxel_m: float = param(0.05, unit="m", doc="Edge of a voxel.", low=0.001, high=10.0)
    fill: bool = param(False, doc="Close holes.")
    ranges_m: tuple[float, ...] = param((1.0, 2.0), unit="m", doc="Bounds of ranges.", low=0.0, high=100.0)
    centre_m: tuple[float, float] = param((0.0, 0.0), unit="m", doc="Centre.", low=-1.0, high=1.0)
    labels: tuple[str, ...] = param(("a",), doc="Words.")
    ends: tuple[str, str] = param(("a", "b"), doc="First and last word.")
    matcher: Matcher = field(default_factory=Matcher)


BOMB = "a0: &a0 {x: 1}\n" + "".join(f"a{i + 1}: &a{i + 1} {{x: *a{i}, y: *a{i}}}\n" for i in range(30))
"""A mapping of 2^30 values in 30 lines."""


wholes = st.builds(
    Whole,
    voxel_m=st.floats(0.001, 10.0),
    fill=st.booleans(),
    ranges_m=st.lists(st.floats(0, 100.0), max_size=4).map(tuple),
    labels=st.lists(st.text(max_size=5), max_size=3).map(tuple),
    matcher=st.builds(Matcher, max_disparity=st.integers(1, 256), method=st.sampled_from(["blocks", "pixels"])),
)


@given(wholes)
def test_build_of_flatten_is_the_same(config: Whole) -> None:
    assert build(Whole, flatten(config)) == config


def test_nested_names_in_both_forms_and_whole_numbers_where_they_mean_the_same() -> None:
    for values in ({"matcher.max_disparity": 8}, {"matcher": {"max_disparity": 8}}):
        assert build(Whole, values) == replace(Whole(), matcher=Matcher(max_disparity=8))
    built = build(Whole, {"voxel_m": 1, "ranges_m": [1, 2.5], "labels": []})
    assert built == replace(Whole(), voxel_m=1.0, ranges_m=(1.0, 2.5), labels=())
    assert build(Whole, {"centre_m": (np.float32(0.5), np.int64(1))}).centre_m == (0.5, 1.0)
    assert build(Whole, {"matcher": None}) == build(Whole, {"matcher": {}}) == Whole()
    assert (type(built.voxel_m), type(built.ranges_m[0])) == (float, float)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"voxel": 1.0}, "unknown key 'voxel' (did you mean 'voxel_m'?)"),
        (
            {"matcher": {"max_dispariti": 3}},
            "unknown key 'matcher.max_dispariti' (did you mean 'matcher.max_disparity'?)",
        ),
        ({"voxel_m": 0.0}, "'voxel_m' is 0.0: 0.001 to 10.0 m is required"),
        ({"voxel_m": float("nan")}, "'voxel_m' is nan: 0.001 to"),
        ({"fill": 1}, "'fill' is 1: true or false is required"),
        ({"matcher.method": "block"}, "'matcher.method' is 'block': one of blocks, pixels"),
        ({"ranges_m": [1.0, -1.0]}, "'ranges_m' is -1.0: 0.0 to 100.0 m is required"),
        ({"voxel_m": 10**400}, "a number is required"),
        ({"ranges_m": 1.0}, "a list of numbers is required"),
        ({"centre_m": [1.0]}, "'centre_m' is [1.0]: a list of 2 numbers is required"),
        ({"ends": ["a"]}, "'ends' is ['a']: a list of 2 texts is required"),
        ({"labels": [1]}, "'labels' is [1]: a list of texts is required"),
        ({"matcher": 5}, "'matcher' is 5: a mapping of names to values is required"),
        ({"matchr": {}}, "unknown key 'matchr' (did you mean 'matcher.method'?)"),
        ({"voxel_m": {}}, "'voxel_m' is {}: a number is required"),
        ({"voxel": 1.0, "fill": 1}, "unknown key 'voxel' (did you mean 'voxel_m'?); 'fill' is 1"),
    ],
)
def test_wrong_values_are_one_line_with_the_origin(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(words)) as caught:
        build(Whole, values, origin="some.yaml")
    assert str(caught.value).startswith("some.yaml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("config_type", [LocalisationConfig, MappingConfig, ScoreConfig, SimulationConfig])
def test_every_number_of_the_suite_refuses_infinity(config_type: type) -> None:
    for info in parameters(config_type):
        for absurd in (math.inf, -math.inf, math.nan, 1e300) if info.type in (int, float, tuple[float, ...]) else ():
            with pytest.raises(ConfigError, match=f"'{info.name}'"):
                build(config_type, {info.name: (absurd,) if isinstance(info.default, tuple) else absurd})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"a: [1", "not valid YAML"),
        (b"\xff\xfe\xff", "not valid YAML"),
        (b"- 1\n- 2", "names with values"),
        (b"a: !!python/object:os.system {}", "not valid YAML"),
        (b"a: " + b"9" * 400, "an integer of 400 digits"),
        (b"[" * 1000, "nested too deeply"),
        (b"a: &a [*a]", "within its own anchor"),
        (b"a: 1\nb: {c: 1, c: 2}", "'c' occurs twice, the second time in line 2"),
        (b"yes: 1\ntrue: 2", "'true' occurs twice, the second time in line 2"),
        (b"a: {1: 1, 01: 2}", "'01' occurs twice"),
        (BOMB.encode(), "aliases expand to more than 100000 values"),
        (b"#" * 1_000_001, "larger than 1 MB"),
        (None, "cannot read '.*c.yaml': No such file"),
    ],
)
def test_files_that_are_no_mapping(tmp_path: Path, content: bytes | None, words: str) -> None:
    path = tmp_path / "c.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=words) as caught:
        load_yaml(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_names_and_merged_maps_of_yaml(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    lines = ["a: &a {x: 1}", "b: &b {y: 1e-3}", "c: {<<: *a, <<: *b, x: 2}"]
    lines += ["d: {1e-3: 1.5e3, 1: one, '1': text}", "e: [1:30, 1:30.5]", "f: [030, 08, -.5, 0x1F, .inf]"]
    path.write_text("\n".join(lines))
    content = load_yaml(path)
    assert content["c"] == {"x": 2, "y": 0.001}
    assert content["e"] == ["1:30", "1:30.5"], "not numbers of base 60"
    assert content["f"] == [30, 8, -0.5, 31, math.inf], "not octal"
    assert content["d"] == {"1e-3": 1500.0, 1: "one", "1": "text"}


@given(st.one_of(st.text(max_size=8), st.lists(st.text(max_size=8) | st.integers(), max_size=3)))
def test_a_value_is_one_line_of_yaml_and_is_read_back(value: object) -> None:
    text = yaml_text(value)
    assert len(text.splitlines()) == 1
    assert yaml.safe_load(text) == value


@pytest.mark.parametrize("wrong", [float | None, complex, list[float], tuple[float, Path]])
def test_a_parameter_of_another_type_is_refused_at_its_first_use(wrong: type) -> None:
    cls = make_dataclass("Other", [("value", wrong, param(None, doc="Any value."))], frozen=True)
    with pytest.raises(TypeError, match="the parameter value has the type"):
        build(cls, {"value": "x"})


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


@pytest.mark.parametrize("name", ["thruth", "topic", "ground_truth", "camera", "max_features", "/**.ros__params"])
def test_an_unknown_section_is_refused_also_if_it_is_the_only_one(tmp_path: Path, name: str) -> None:
    (tmp_path / "sfr.yaml").write_text(f"{name}: {{file: x}}\n")
    with pytest.raises(ConfigError, match=r"sfr\.yaml: unknown section '"):
        sections_of(tmp_path / "sfr.yaml")


def test_parameters_beside_a_section_are_refused(tmp_path: Path) -> None:
    (tmp_path / "sfr.yaml").write_text("localisation: {min_inliers: 20}\nmax_features: 300\n")
    with pytest.raises(ConfigError, match=r"sfr\.yaml: unknown section 'max_features'"):
        sections_of(tmp_path / "sfr.yaml")


@pytest.mark.parametrize("node", ["/**", "/**/localisation_node", "localisation_node"])
def test_a_misspelt_prefix_in_a_ros_parameter_file_is_refused(tmp_path: Path, node: str) -> None:
    (tmp_path / "nodes.yaml").write_text(f"{node}:\n  ros__parameters: {{localization: {{max_features: 300}}}}\n")
    with pytest.raises(
        ConfigError, match=r"unknown parameter 'localization\.max_features' .*did you mean 'localisation'"
    ):
        sections_of(tmp_path / "nodes.yaml")


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
        ("/**: {ros__parameters: {localisation: 5}}\n", "'localisation' is 5: a mapping"),
        ("/**: {ros__parameters: 5}\n", "'/\\*\\*.ros__parameters' is 5: a mapping"),
    ],
)
def test_an_ambiguous_or_malformed_file_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "file.yaml").write_text(text)
    with pytest.raises(ConfigError, match=rf"file\.yaml: {words}"):
        sections_of(tmp_path / "file.yaml")


def test_an_empty_section_does_not_remove_its_values(tmp_path: Path) -> None:
    (tmp_path / "sfr.yaml").write_text("truth.source: a\ntruth:\nlimits:\nmapping: {}\n")
    assert sections_of(tmp_path / "sfr.yaml") == {"truth": {"source": "a"}}


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
