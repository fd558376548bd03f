from dataclasses import dataclass, field
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.parameter import Parameter

from sfr_loc_map.config import flatten, param
from sfr_loc_map.nodes.lifecycle.parameters import Parameters
from sfr_loc_map.nodes.parameter_files import FILES, parameter_file

CONFIG = Path(__file__).resolve().parents[3] / "config"


@dataclass(frozen=True, slots=True)
class Inner:
    gain: float = param(0.5, unit="m", doc="How much.", low=0.0, high=2.0)
    names: tuple[str, ...] = param(("a", "b"), doc="Which.")


@dataclass(frozen=True, slots=True)
class Outer:
    count: int = param(3, doc="How many.", low=1, high=9)
    way: str = param("left", doc="Where to.", choices=("left", "right"))
    live: bool = param(False, doc="Switch.", live=True)
    axis: tuple[float, ...] = param((0.0, 1.0), doc="Axis.", low=-9.0, high=9.0)
    inner: Inner = field(default_factory=Inner)


def node_with(**values: object) -> rclpy.node.Node:
    overrides = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
    return rclpy.create_node("tried", parameter_overrides=overrides)


def test_descriptors_come_from_the_fields_and_overrides_reach_the_configuration(ros: None) -> None:
    node = node_with(inner__gain=2, count=7, axis=[3.0, 4.0], inner__names=["z"], use_sim_time=False)
    assert Parameters(node, Outer).config == Outer(count=7, axis=(3.0, 4.0), inner=Inner(2.0, ("z",)))
    assert node.get_parameter("inner.gain").value == 2.0
    gain, count = node.describe_parameter("inner.gain"), node.describe_parameter("count")
    assert gain.description == "How much. [m]"
    assert (gain.floating_point_range[0].from_value, gain.floating_point_range[0].to_value) == (0.0, 2.0)
    assert (count.integer_range[0].from_value, count.integer_range[0].to_value) == (1, 9)
    held = "read-only unless the node is unconfigured"
    texts = {"axis": f"each from -9 to 9; {held}", "way": f"one of: left, right; {held}", "count": held, "live": ""}
    for name, text in texts.items():
        assert node.describe_parameter(name).additional_constraints == text
    node.destroy_node()


@pytest.mark.parametrize("name", FILES)
def test_parameter_files_hold_all_fields_at_their_defaults(name: str) -> None:
    node_name, config_type = FILES[name]
    text = (CONFIG / name).read_text(encoding="utf-8")
    assert text == parameter_file(node_name, config_type), "run: python -m sfr_loc_map.nodes.parameter_files config"
    content = yaml.safe_load(text)[f"/**/{node_name}"]["ros__parameters"]

    def flat(block: dict, prefix: str = "") -> dict:
        found = {}
        for key, value in block.items():
            found |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
        return found

    values = {n: tuple(v) if isinstance(v, list) else v for n, v in flat(content).items()}
    assert values == flatten(config_type())
