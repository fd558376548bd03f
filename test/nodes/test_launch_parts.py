"""The launch files, run against stand-ins for the packages `launch` and `launch_ros`, which wheels do not have."""

import runpy
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.environment import PROFILE, PROFILE_VARIABLE

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = ROOT / "launch_scripts"


@dataclass
class Made:
    kind: str
    args: tuple[Any, ...]
    options: dict[str, Any] = field(default_factory=dict)

    def perform(self, context: dict[str, str]) -> str:
        """Return the value of a launch argument, as `LaunchConfiguration` does."""
        assert self.kind == "LaunchConfiguration"
        USED.add(self.args[0])
        return context[self.args[0]]


USED: set[str] = set()
"""Launch arguments whose values were asked for."""


def maker(kind: str) -> Any:
    return lambda *args, **options: Made(kind, args, options)


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> Any:
    kinds = {
        "launch": ["LaunchDescription", "LaunchContext"],
        "launch.actions": [
            *("DeclareLaunchArgument", "SetEnvironmentVariable", "ExecuteProcess", "OpaqueFunction", "Shutdown")
        ],
        "launch.substitutions": ["EnvironmentVariable", "LaunchConfiguration", "PythonExpression"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
    }
    for name, members in kinds.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member, maker(member))
        monkeypatch.setitem(sys.modules, name, module)
    index = ModuleType("ament_index_python.packages")
    index.get_package_share_directory = lambda package: str(ROOT)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "ament_index_python", ModuleType("ament_index_python"))
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", index)
    monkeypatch.delitem(sys.modules, "sfr_loc_map.nodes.launch_parts", raising=False)
    USED.clear()

    def describe(name: str, **values: str) -> list[Made]:
        """Return what a launch file makes of values for its arguments."""
        entities: list[Made] = runpy.run_path(str(LAUNCH / name))["generate_launch_description"]().args[0]
        declared = of_kind(entities, "DeclareLaunchArgument")
        assert set(values) <= {item.args[0] for item in declared}
        context = {item.args[0]: item.options.get("default_value", "") for item in declared} | values
        functions = of_kind(entities, "OpaqueFunction")
        made = [item for f in functions for item in f.options["function"](context, *f.options["args"])]
        return [*entities, *made]

    yield describe
    sys.modules.pop("sfr_loc_map.nodes.launch_parts", None)  # it has imported the stand-ins


def of_kind(entities: list[Made], kind: str) -> list[Made]:
    return [item for item in entities if item.kind == kind]


@pytest.mark.parametrize("name", sorted(path.name for path in LAUNCH.glob("*.py")))
def test_arguments_are_described_and_all_that_is_used_is_declared(described: Any, name: str) -> None:
    entities = described(name)
    declared = {item.args[0] for item in of_kind(entities, "DeclareLaunchArgument")}
    assert all(item.options["description"].endswith(".") for item in of_kind(entities, "DeclareLaunchArgument"))
    used: set[str] = set()

    def look(value: Any) -> None:
        if isinstance(value, Made):
            used.update(value.args[:1] if value.kind == "LaunchConfiguration" else ())
            look([*value.args, *value.options.values()])
        elif isinstance(value, (list, tuple)):
            for item in value:
                look(item)

    look(entities)
    assert used | USED == declared


@pytest.mark.parametrize(
    ("name", "tasks"),
    [
        ("sfr.launch.py", ["localisation", "mapping", "monitor"]),
        *((f"{task}.launch.py", [task]) for task in ("localisation", "mapping", "monitor")),
    ],
)
def test_nodes_are_those_installed_and_get_parameter_files_that_exist(
    described: Any, name: str, tasks: list[str]
) -> None:
    entities = described(name)
    nodes = of_kind(entities, "Node")
    assert [node.options["executable"] for node in nodes] == [f"{task}_node" for task in tasks]
    assert all((ROOT / "scripts" / node.options["executable"]).is_file() for node in nodes)
    assert all(node.options["package"] == "sfr_loc_map" for node in nodes)
    for node, task in zip(nodes, tasks, strict=True):
        file, shared = node.options["parameters"]
        assert shared == {"use_sim_time": False, "autostart": True}
        (action,) = node.options["on_exit"]  # where one ends, all end
        assert action.kind == "Shutdown"
        assert f"/**/{task}_node" in yaml.safe_load(Path(file).read_text())
    (profile,) = of_kind(entities, "SetEnvironmentVariable")
    assert profile.args[0] == PROFILE_VARIABLE
    assert (profile.args[1].args, profile.args[1].options) == ((PROFILE_VARIABLE,), {"default_value": str(PROFILE)})


@pytest.mark.parametrize("name", ["sfr.launch.py", "localisation.launch.py"])
def test_values_of_arguments_reach_the_nodes(described: Any, name: str, tmp_path: Path) -> None:
    plain = of_kind(described(name), "Node")[0].options
    assert (plain["namespace"], plain["remappings"], plain["respawn"]) == ("", [], False)
    file = "params_file" if name == "localisation.launch.py" else "localisation_params_file"
    values = {"namespace": "rover1", "log_level": "debug", "use_sim_time": "True", "respawn": "true"}
    (tmp_path / "p.yaml").touch()
    values |= {file: str(tmp_path / "p.yaml"), "frame_prefix": "rover1/", "autostart": "false"}
    remaps = "loc/left/image_rect:=/eye/left  loc/right/image_rect:=/eye/right"
    node = of_kind(described(name, remaps=remaps, **values), "Node")[0].options
    assert (node["namespace"], node["respawn"], node["on_exit"]) == ("rover1", True, [])
    shared = {"use_sim_time": True, "autostart": False, "frame_prefix": "rover1/"}
    assert node["parameters"] == [str(tmp_path / "p.yaml"), shared]
    assert node["arguments"] == ["--ros-args", "--log-level", "debug"]
    assert node["remappings"] == [("loc/left/image_rect", "/eye/left"), ("loc/right/image_rect", "/eye/right")]
    for broken in ("a", "a:=", "a:=b:=c"):
        with pytest.raises(ConfigError, match="FROM:=TO"):
            described(name, remaps=broken)
    for wrong in ({"respawn": "yes"}, {"autostart": ""}, {"use_sim_time": "1"}, {"log_level": "loud"}, {file: "/no"}):
        (argument,) = wrong
        with pytest.raises(ConfigError, match=f"^{argument}:={wrong[argument]}: "):
            described(name, **wrong)


def test_the_replay_calls_the_command_with_options_that_it_has(described: Any) -> None:
    from typer.testing import CliRunner

    from sfr_loc_map.cli.main import app

    (process,) = of_kind(described("replay.launch.py"), "ExecuteProcess")
    python, dash_c, code, command, *options = process.options["cmd"]
    assert (python, dash_c, command) == (sys.executable, "-c", "replay")
    compile(code, "launch", "exec")
    text = CliRunner().invoke(app, ["replay", "--help"], env={"COLUMNS": "200", "TERM": "dumb"}).output
    assert all(option in text for option in options if isinstance(option, str))
    assert [o for o in options if isinstance(o, str)] == ["--out", "--rate", "--start", "--start-offset"]
    for name, option in zip(("loop", "overwrite"), options[-2:], strict=True):
        assert [part.args for part in option.args[0] if isinstance(part, Made)] == [(name,)] * 2
        for value, switch in (("true", ""), ("True", ""), ("false", "no-"), ("maybe", None)):
            made = eval("".join(value if isinstance(part, Made) else part for part in option.args[0]))
            assert made == (f"--{name}=maybe" if switch is None else f"--{switch}{name}")
            assert switch is None or made in text
    refused = CliRunner().invoke(app, ["replay", "x", "--loop=maybe"])
    assert refused.exit_code == 2
