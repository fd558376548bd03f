"""The launch files, run against stand-ins for the packages `launch` and `launch_ros`, which wheels do not have."""

import runpy
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from sfr_loc_map.nodes.environment import PROFILE, PROFILE_VARIABLE

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = ROOT / "launch_scripts"


@dataclass
class Made:
    kind: str
    args: tuple[Any, ...]
    options: dict[str, Any] = field(default_factory=dict)


def maker(kind: str) -> Any:
    return lambda *args, **options: Made(kind, args, options)


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> Any:
    kinds = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "SetEnvironmentVariable", "ExecuteProcess"],
        "launch.substitutions": ["EnvironmentVariable", "LaunchConfiguration"],
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

    def describe(name: str) -> list[Made]:
        entities: list[Made] = runpy.run_path(str(LAUNCH / name))["generate_launch_description"]().args[0]
        return entities

    return describe


def of_kind(entities: list[Made], kind: str) -> list[Made]:
    return [item for item in entities if item.kind == kind]


@pytest.mark.parametrize("name", ["sfr.launch.py", "localisation.launch.py", "replay.launch.py"])
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
    assert used == declared


@pytest.mark.parametrize(
    ("name", "tasks"),
    [("sfr.launch.py", ["localisation", "mapping", "monitor"]), ("localisation.launch.py", ["localisation"])],
)
def test_nodes_are_those_installed_and_get_parameter_files_that_exist(
    described: Any, name: str, tasks: list[str]
) -> None:
    entities = described(name)
    nodes = of_kind(entities, "Node")
    assert [node.options["executable"] for node in nodes] == [f"{task}_node" for task in tasks]
    assert all((ROOT / "scripts" / node.options["executable"]).is_file() for node in nodes)
    assert all(node.options["package"] == "sfr_loc_map" for node in nodes)
    defaults = {d.args[0]: d.options.get("default_value") for d in of_kind(entities, "DeclareLaunchArgument")}
    for node, task in zip(nodes, tasks, strict=True):
        (file,) = node.options["parameters"]
        assert f"/**/{task}_node" in yaml.safe_load(Path(defaults[file.args[0]]).read_text())
    (profile,) = of_kind(entities, "SetEnvironmentVariable")
    assert profile.args[0] == PROFILE_VARIABLE
    assert (profile.args[1].args, profile.args[1].options) == ((PROFILE_VARIABLE,), {"default_value": str(PROFILE)})


def test_the_replay_calls_the_command_with_options_that_it_has(described: Any) -> None:
    from typer.testing import CliRunner

    from sfr_loc_map.cli.main import app

    (process,) = of_kind(described("replay.launch.py"), "ExecuteProcess")
    python, dash_c, code, command, *options = process.options["cmd"]
    assert (python, dash_c, command) == (sys.executable, "-c", "replay")
    compile(code, "launch", "exec")
    text = CliRunner().invoke(app, ["replay", "--help"], env={"COLUMNS": "200", "TERM": "dumb"}).output
    assert all(option in text for option in options if isinstance(option, str))


def test_launch_files_are_installed() -> None:
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    assert "launch_scripts/*.launch.py" in setup
    assert sorted(path.name for path in LAUNCH.glob("*.launch.py")) == [
        "localisation.launch.py",
        "replay.launch.py",
        "sfr.launch.py",
    ]
