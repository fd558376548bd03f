"""The direction of imports, read from the syntax trees: nothing is imported here."""

import ast
from collections.abc import Sequence
from pathlib import Path

import pytest

import sfr_loc_map

PACKAGE = Path(sfr_loc_map.__file__).parent
NAME = PACKAGE.name
FLOORS = (
    {
        *("__init__", "atomic", "errors", "inputs", "config", "jit", "kernels", "child_process", "signals"),
        *(
            "host_clock",
            "memory_mark",
            "parallel",
            "process_tree",
            "message_types",
            "run_order",
            "stamp_pairing",
            "topics",
        ),
        *("graph_endpoints", "issues", "stamp_pairing", "topics"),
        *("hashes", "json_yaml", "package_commit"),
    },
    {"geometry"},
    {"io", "localisation", "mapping", "metrics"},
    {"faults", "methods", "report", "simulation"},
    {"runs", "source_setup"},
    {"scoring"},
    {"doctor", "evidence"},
    {"bench", "live", "suite"},
    {"nodes"},
    {"__main__", "cli", "api", "api_types"},
)
"""From the bottom; what stands on one floor does not import its neighbours, but the root modules do."""
NODE_FLOORS = ({"ros"}, {"lifecycle"}, {"input"}, {""}, {"launch", "graph"}, {"replay", "view"})
"""Folders of `nodes` from the bottom; the name of the modules beside them is empty."""
IO_FLOORS = (
    {"sequence", "tables"},
    {"images", "calibration", "clouds"},
    {"bag"},
    {"source_files", "truth"},
    {"source_config"},
    {"layouts"},
    {"convert", "message_stream", "registry"},
)
"""Folders of `io`, and the modules beside them, from the bottom."""
NEIGHBOURS = {("api", "api_types"), ("cli", "api"), ("__main__", "cli")}
ROS = ("rclpy", "launch", "launch_ros", "ament_index_python", "builtin_interfaces", "std_srvs", "rosidl", "tf2_ros")
ROS_PACKAGES = {"nodes"}
FILES = sorted(PACKAGE.rglob("*.py"))


def layer_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    """Return the dotted names that a module imports, anywhere in it; relative ones begin with a dot."""
    names: set[str] = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{'.' * node.level + (node.module or '')}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and "import_module" in ast.unparse(node.func):
            names |= {arg.value for arg in node.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)}
    return names


def is_ros(name: str) -> bool:
    head = name.split(".")[0]
    return head.endswith("_msgs") or head.startswith("rosidl") or head in ROS


def test_modules_import_lower_floors_alone_and_ros_only_in_nodes() -> None:
    floor = {layer: number for number, layers in enumerate(FLOORS) for layer in layers}
    wrong = []
    for path in FILES:
        layer = layer_of(path)
        for name in imported(path):
            head, *rest = name.split(".")
            other = rest[0] if head == NAME and rest and rest[0] in floor else layer
            below = floor[other] < floor[layer] or other == layer or floor[layer] == 0 or (layer, other) in NEIGHBOURS
            if not below or head == "" or (is_ros(name) and layer not in ROS_PACKAGES):
                wrong.append(f"{path.relative_to(PACKAGE)}: {name}")
    assert not wrong


@pytest.mark.parametrize(("layer", "floors"), [("io", IO_FLOORS), ("nodes", NODE_FLOORS)])
def test_folders_of_a_layer_import_lower_folders_alone(layer: str, floors: Sequence[set[str]]) -> None:
    floor = {folder: number for number, folders in enumerate(floors) for folder in folders}
    wrong = []
    for path in (PACKAGE / layer).rglob("*.py"):
        first = path.relative_to(PACKAGE / layer).parts[0].removesuffix(".py")
        own = first if first in floor else ""
        assert own in floor or first == "__init__", f"{path.relative_to(PACKAGE)} is on no floor"
        for name in imported(path):
            head, _, rest = name.partition(f"{NAME}.{layer}.")
            folder = rest.split(".")[0] if rest.split(".")[0] in floor else ""
            if not head and rest and own != folder and floor[own] <= floor[folder]:
                wrong.append(f"{path.relative_to(PACKAGE)}: {name}")
    assert not wrong


def test_metrics_do_not_import_the_judge() -> None:
    judging = f"{NAME}.metrics.judging"
    folder = PACKAGE / "metrics"
    wrong = [path.name for path in folder.glob("*.py") if any(name.startswith(judging) for name in imported(path))]
    assert wrong == ["stored.py"]  # a score that was read is judged again


def test_no_circle_among_modules() -> None:
    modules = {
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): path
        for path in FILES
    }
    left = {
        module: {n for name in imported(path) for n in (name, name.rpartition(".")[0]) if n in modules} - {module}
        for module, path in modules.items()
        if path.name != "__init__.py"
    }
    while free := [module for module, targets in left.items() if not targets & left.keys()]:
        for module in free:
            del left[module]
    assert not sorted(left)
