"""The launch files, run against stand-ins for the packages `launch` and `launch_ros`, which wheels do not have."""

import runpy
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from helpers import ROOT
from sfr_loc_map.errors import SfrError
from sfr_loc_map.ros.environment import PROFILE, PROFILE_VARIABLES

KINDS = {
    "launch": ["LaunchDescription", "LaunchContext"],
    "launch.actions": [*("DeclareLaunchArgument", "SetEnvironmentVariable", "OpaqueFunction", "Shutdown")],
    "launch.substitutions": ["EnvironmentVariable", "LaunchConfiguration"],
    "launch_ros": [],
    "launch_ros.actions": ["Node"],
    "ament_index_python": [],
    "ament_index_python.packages": [],
}
ALL = ["localisation", "mapping", "monitor"]


@dataclass
class Made:
    kind: str
    args: tuple[Any, ...]
    options: dict[str, Any] = field(default_factory=dict)

    def perform(self, context: dict[str, str]) -> str:
        """Return the value of a launch argument, as `LaunchConfiguration` does."""
        assert self.kind == "LaunchConfiguration"
        return context[self.args[0]]


def make(kind: str, *args: Any, **options: Any) -> Made:
    return Made(kind, args, options)


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    for name, members in KINDS.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member, partial(make, member))
        module.get_package_share_directory = lambda package: str(ROOT)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "sfr_loc_map.nodes.launch.launch_parts", raising=False)

    def describe(name: str, **values: str) -> dict[str, list[Made]]:
        """Return what a launch file makes of values for its arguments, by kind."""
        path = ROOT / "launch_scripts" / f"{name}.launch.py"
        entities: list[Made] = runpy.run_path(str(path))["generate_launch_description"]().args[0]
        declared = {item.args[0]: item.options for item in entities if item.kind == "DeclareLaunchArgument"}
        assert all(options["description"].endswith(".") for options in declared.values())
        assert all(value in (declared[given].get("choices") or [value]) for given, value in values.items())
        context = {given: options.get("default_value", "") for given, options in declared.items()} | values
        found: dict[str, list[Made]] = {}
        for item in entities:
            made = [item]
            if item.kind == "OpaqueFunction":
                made += item.options["function"](context)
            for each in made:
                found.setdefault(each.kind, []).append(each)
        return found

    yield describe
    sys.modules.pop("sfr_loc_map.nodes.launch.launch_parts", None)  # it has imported the stand-ins


@pytest.mark.parametrize(("name", "tasks"), [("sfr", ALL), *(("node", [task]) for task in ALL)])
def test_nodes_are_those_installed_and_get_parameter_files_that_exist(
    described: Any, name: str, tasks: list[str]
) -> None:
    entities = described(name, **({"node": tasks[0]} if name == "node" else {}))
    assert [node.options["executable"] for node in entities["Node"]] == [f"{task}_node" for task in tasks]
    for node, task in zip(entities["Node"], tasks, strict=True):
        assert (ROOT / "scripts" / node.options["executable"]).is_file()
        assert node.options["package"] == "sfr_loc_map"
        file, shared = node.options["parameters"]
        assert shared == {}, "these values would override those of the file"
        (action,) = node.options["on_exit"]  # where one ends, all end
        assert action.kind == "Shutdown"
        assert f"/**/{task}_node" in yaml.safe_load(Path(file).read_text())
    profiles = {item.args[0]: item.args[1] for item in entities["SetEnvironmentVariable"]}
    assert set(profiles) == set(PROFILE_VARIABLES)
    for variable, value in profiles.items():
        assert (value.args, value.options) == ((variable,), {"default_value": str(PROFILE)})


@pytest.mark.parametrize(("name", "file"), [("sfr", "localisation_params_file"), ("node", "params_file")])
def test_values_of_arguments_reach_the_nodes(described: Any, name: str, file: str, tmp_path: Path) -> None:
    which = {"node": "localisation"} if name == "node" else {}
    plain = described(name, **which)["Node"][0].options
    assert (plain["namespace"], plain["remappings"], plain["respawn"]) == ("", [], False)
    (tmp_path / "p.yaml").touch()
    values = which | {"namespace": "rover1", "log_level": "debug", "use_sim_time": "true", "respawn": "true"}
    values |= {file: str(tmp_path / "p.yaml"), "frame_prefix": "rover1/", "autostart": "false"}
    values["remaps"] = "loc/left/image_rect:=/eye/left  loc/right/image_rect:=/eye/right"
    node = described(name, **values)["Node"][0].options
    assert (node["namespace"], node["respawn"], node["on_exit"]) == ("rover1", True, None)
    shared = {"use_sim_time": True, "autostart": False, "frame_prefix": "rover1/"}
    assert node["parameters"] == [str(tmp_path / "p.yaml"), shared]
    assert node["arguments"] == ["--ros-args", "--log-level", "debug"]
    assert node["remappings"] == [("loc/left/image_rect", "/eye/left"), ("loc/right/image_rect", "/eye/right")]
    for argument, value in [(file, "/no"), ("remaps", "a"), ("remaps", "a:="), ("remaps", "a:=b:=c")]:
        with pytest.raises(SfrError, match=f"^{argument}:={value}: "):
            described(name, **which, **{argument: value})
