"""The direction of imports, read from the syntax trees: nothing is imported here."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

import sfr_loc_map

PACKAGE = Path(sfr_loc_map.__file__).parent
NAME = PACKAGE.name
ROOT = "package root"

BASE = {ROOT, "errors", "bounded_input", "config", "constants", "jit", "geometry", "printable", "child_process"}
MIDDLE = {"localisation", "mapping", "metrics", "simulation", "io"}
UPPER = {"api", "tables", "methods", "pipeline", "report", "nodes", "bench", "suite", "fault_injection", "live"}
ALLOWED: dict[str, set[str]] = {
    ROOT: set(),
    "constants": {ROOT},
    "jit": {ROOT},
    "errors": {ROOT},
    "printable": {ROOT},
    "child_process": {ROOT},
    "tables": {ROOT, "printable"},
    "bounded_input": {ROOT},
    "config": {ROOT, "errors", "bounded_input"},
    "geometry": {ROOT, "errors", "config", "constants", "jit"},
    **dict.fromkeys(MIDDLE, BASE),
    "methods": BASE | {"localisation", "mapping", "metrics", "io"},
    "pipeline": BASE | MIDDLE | {"methods"},
    "report": BASE | MIDDLE | {"tables"},
    "live": BASE | MIDDLE | {"pipeline", "report", "tables"},
    "api": BASE | (MIDDLE - {"simulation"}) | {"methods", "pipeline", "report", "tables"},
    "nodes": BASE | (MIDDLE - {"simulation"}) | {"pipeline", "live"},
    "bench": BASE | MIDDLE | {"methods", "pipeline", "tables"},
    "suite": BASE | MIDDLE | {"methods", "pipeline", "report", "tables"},
    "fault_injection": BASE | (MIDDLE - {"simulation"}) | {"pipeline", "nodes", "tables"},
    "cli": BASE | MIDDLE | UPPER,
}
ROS = ("rclpy", "launch", "launch_ros", "ament_index_python", "builtin_interfaces", "std_srvs", "rosidl", "tf2_ros")

ROS_LAYERS = {"nodes", "fault_injection"}

FILES = sorted(PACKAGE.rglob("*.py"))


def layer_of(path: Path) -> str:
    first = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    return ROOT if first == "__init__" else first


def imported(tree: ast.AST) -> set[str]:
    """Return the dotted names that a module imports, anywhere in it; relative ones begin with a dot."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            names |= {f"{module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and "import_module" in ast.unparse(node.func):
            names |= {arg.value for arg in node.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)}
    return names


def layers_of(names: set[str]) -> set[str]:
    """Return the layers of this package among imported names."""
    found = set()
    for name in names:
        head, *rest = name.split(".")
        if head == NAME:
            part = rest[0] if rest else ""
            found.add(part if (PACKAGE / part).is_dir() or (PACKAGE / f"{part}.py").exists() else ROOT)
    return found


def is_ros(name: str) -> bool:
    head = name.split(".")[0]
    return head.endswith("_msgs") or head.startswith("rosidl") or head in ROS


def relative(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


@pytest.mark.parametrize("path", FILES, ids=relative)
def test_layer_imports_only_lower_layers(path: Path) -> None:
    layer = layer_of(path)
    names = imported(ast.parse(path.read_text(encoding="utf-8")))
    assert layers_of(names) <= ALLOWED[layer] | {layer}
    assert not [name for name in names if name.startswith(".")], "imports are absolute"
    if layer not in ROS_LAYERS:
        assert not [name for name in names if is_ros(name)], "only nodes and what drives them import ROS"


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in FILES}


def modules_of(names: set[str]) -> set[str]:
    """Return the modules of this package that imported names lie in."""
    return {next((n for n in (name, name.rpartition(".")[0]) if n in MODULES), "") for name in names} - {""}


@cache
def imported_modules(path: Path) -> frozenset[str]:
    """Return the modules of this package that a module imports."""
    return frozenset(modules_of(imported(ast.parse(path.read_text(encoding="utf-8")))))


def rooms(folder: str) -> dict[str, set[str]]:
    """Return what each module and sub-folder of a folder imports of its neighbours there."""
    graph: dict[str, set[str]] = {}
    for name, path in MODULES.items():
        room = name.removeprefix(folder + ".").split(".")[0]
        if not name.startswith(folder + "."):
            continue
        seen = imported_modules(path)
        near = {other.removeprefix(folder + ".").split(".")[0] for other in seen if other.startswith(folder + ".")}
        graph.setdefault(room, set()).update(near - {room})
    return graph


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return what is left of a graph when all that nothing leads back to is taken away: empty without a circle."""
    left = dict(graph)
    while free := [room for room, targets in left.items() if not targets & set(left)]:
        for room in free:
            del left[room]
    return sorted(left)


PACKAGES = sorted(name for name, path in MODULES.items() if path.name == "__init__.py")


@pytest.mark.parametrize("folder", PACKAGES)
def test_no_circle_among_the_rooms_of_a_folder(folder: str) -> None:
    assert circle(rooms(folder)) == []


def test_circles_are_seen() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["a", "b", "c"]


def test_every_layer_is_known() -> None:
    assert {layer_of(path) for path in FILES} <= set(ALLOWED)


@pytest.mark.parametrize(
    ("code", "layers", "ros"),
    [
        ("import sfr_loc_map.io.bag", {"io"}, False),
        ("from sfr_loc_map import nodes", {"nodes"}, False),
        ("from sfr_loc_map import __version__", {ROOT}, False),
        ("def f():\n    from sfr_loc_map.mapping import mapper", {"mapping"}, False),
        ("importlib.import_module('sfr_loc_map.report.page')", {"report"}, False),
        ("if TYPE_CHECKING:\n    from nav_msgs.msg import Odometry", set(), True),
        ("import rclpy.node", set(), True),
        ("from rosbags.rosbag2 import Reader", set(), False),
    ],
)
def test_imports_are_seen(code: str, layers: set[str], ros: bool) -> None:
    names = imported(ast.parse(code))
    assert layers_of(names) == layers
    assert any(map(is_ros, names)) == ros
