"""Imports go downwards through the layers. The imports are read from the source, without importing a module."""

import ast
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import pytest

import sfr_loc_map

PACKAGE = Path(sfr_loc_map.__file__).parent
NAME = PACKAGE.name
LAYERS = {
    "configuration": ("", "Parameters: their declaration, and the YAML files that give their values"),
    "geometry": ("", "Values with frames and units: rotations, transforms, cameras, trajectories, clouds"),
    "io": ("configuration geometry", "Reading and writing of recorded data"),
    "localisation": ("configuration geometry", "The trajectory of a drive from its stereo pairs"),
    "mapping": ("configuration geometry", "A point cloud and the terrain from one to three stereo pairs"),
    "kernels": ("localisation mapping", "The compiled code of localiser and mapper, loaded or compiled in a process"),
    "metrics": ("configuration geometry", "The figures of the specification, and the verdicts by limits"),
    "faults": ("geometry io", "Faults that are injected into the stereo pairs of a source"),
    "simulation": ("configuration geometry io", "Stereo pairs of a Mars-like scene with exact truth"),
    "tables": ("", "The model of a table, and its formats: terminal, HTML, Markdown and CSV"),
    "report": (
        "configuration geometry metrics tables",
        "Views of scores and other results; a view computes no verdict",
    ),
    "ros": ("geometry io localisation mapping", "The parts that every program with a ROS node requires"),
    "calls": (
        "geometry io localisation mapping metrics",
        "The record of each call of a localiser or mapper, and its forms",
    ),
    "methods": (
        "configuration geometry io localisation mapping metrics",
        "Localisers and mappers under test, in their processes",
    ),
    "runs": (
        "calls configuration geometry io kernels localisation mapping methods metrics",
        "A localiser or mapper over a complete source, and its files",
    ),
    "source_setup": (
        "configuration geometry io localisation mapping metrics tables",
        "The content of a source, and its `sfr.yaml`",
    ),
    "scoring": (
        "calls configuration geometry io mapping metrics",
        "A score with its provenance from files, memory or topics",
    ),
    "doctor": ("configuration geometry io source_setup", "The issues of an observed recording or graph"),
    "nodes": (
        "calls configuration geometry io kernels localisation mapping metrics ros scoring",
        "The three nodes, from a message to a result, and their processes",
    ),
    "graph": ("doctor geometry io ros", "Programs that observe or record a running graph"),
    "live": (
        "calls configuration geometry io localisation mapping metrics report ros tables",
        "Views of a run in progress, and their connection to the nodes",
    ),
    "replay": (
        "calls configuration geometry io live localisation mapping methods metrics nodes ros runs scoring",
        "A source that is played to the nodes, and the score of their results",
    ),
    "bench": (
        "faults geometry io localisation mapping methods metrics runs tables",
        "Benchmarks, one drive after the other",
    ),
    "suite": (
        "calls configuration faults geometry io localisation mapping methods metrics report runs scoring "
        "simulation tables",
        "Many runs on Dask, and their pooled results",
    ),
    "evidence": (
        "calls configuration faults geometry io kernels localisation mapping metrics report runs suite tables",
        "What supports a verdict: the check without a ground truth, and the evidence of a test report",
    ),
    "cli": (
        "bench calls configuration doctor evidence faults geometry graph io live localisation mapping methods "
        "metrics nodes replay report ros runs scoring simulation source_setup suite tables",
        "The subcommands of `sfr`",
    ),
    "__main__": ("cli", "`python -m sfr_loc_map`"),
    "api_types": (
        "calls configuration geometry io localisation metrics report tables",
        "The types of the Python interface",
    ),
    "api": (
        "api_types calls configuration geometry io localisation mapping methods metrics runs scoring",
        "The functions of Python users",
    ),
}
"""Folders, and modules beside them, from the bottom: what of these each imports, exactly, and its subject.

All other modules beside the folders are below them and import none of these.
"""
ROS_FOLDERS = {"ros", "nodes", "graph", "live", "replay"}
NODE_FLOORS = ({"lifecycle"}, {"stereo"}, {"localisation", "monitor"}, {""}, {"launch"})
"""Folders of `nodes` from the bottom; the name of the modules beside them is empty."""
IO_FLOORS = (
    {"number_text"},
    {"stamps"},
    {"tables"},
    {"image_codec", "calibration", "clouds"},
    {"bag"},
    {"source_format"},
    {"truth"},
    {"source_config"},
    {"sequence"},
    {"layouts"},
    {"convert", "message_stream", "registry"},
)
"""Folders of `io`, and the modules beside them, from the bottom."""
LOCALISATION_FLOORS = (
    {"config", "motion_size", "small_linalg"},
    {"estimate"},
    {"frontend"},
    {"backend"},
    {"findings"},
    {"uncertainty"},
    {"motion_model", "relocalisation"},
    {"ground", "path"},
    {""},
)
"""Folders of `localisation`, and the modules below them, from the bottom; the name of the other modules is empty."""
METRICS_FLOORS = (
    {"conditions", "formulas"},
    {"config"},
    {"other_formulas", "statistics"},
    {"sub_trajectories"},
    {"figures"},
    {"frames"},
    {"completeness", "conventions"},
    {"trajectory", "map", "calls"},
    {"score"},
    {"judging"},
    {"stored"},
    {"comparison"},
)
"""Folders of `metrics`, and the modules beside them, from the bottom."""
SUITE_FLOORS = ({"jobs"}, {"planning"}, {"store", "workers"}, {"statistics"}, {"history", "search"}, {"pages"}, {"run"})
"""Folders of `suite`, and the modules beside them, from the bottom."""
ROS = ("rclpy", "launch", "launch_ros", "ament_index_python", "builtin_interfaces", "std_srvs", "rosidl", "tf2_ros")
FILES = sorted(PACKAGE.rglob("*.py"))


def layer_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@cache
def imported(path: Path) -> frozenset[str]:
    """Return the dotted names that a module imports, anywhere in it; relative ones begin with a dot."""
    names: set[str] = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{'.' * node.level + (node.module or '')}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and "import_module" in (
            getattr(node.func, "attr", ""),
            getattr(node.func, "id", ""),
        ):
            names |= {arg.value for arg in node.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)}
    return frozenset(names)


def is_ros(name: str) -> bool:
    head = name.split(".")[0]
    return head.endswith("_msgs") or head.startswith("rosidl") or head in ROS


def layers_that(name: str) -> set[str]:
    """Return the other layers that the modules of a layer, or a module beside the layers, import."""
    files = sorted((PACKAGE / name).rglob("*.py")) or [PACKAGE / f"{name}.py"]
    names = [found.split(".") for path in files for found in imported(path)]
    return {parts[1] for parts in names if parts[0] == NAME and len(parts) > 1} & LAYERS.keys() - {name}


@pytest.mark.parametrize("layer", LAYERS)
def test_a_layer_imports_the_lower_layers_that_are_drawn(layer: str) -> None:
    drawn = set(LAYERS[layer][0].split())
    below = [*LAYERS][: [*LAYERS].index(layer)]
    assert layers_that(layer) == drawn
    assert drawn <= {*below}


def test_all_folders_are_drawn_and_other_modules_import_no_layer() -> None:
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} <= LAYERS.keys()
    others = {path.stem for path in PACKAGE.glob("*.py")} - LAYERS.keys()
    assert {name: found for name in others if (found := layers_that(name))} == {}


def test_the_page_has_the_same_drawing() -> None:
    page = " ".join((PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8").split())
    rows = " ".join(f"{name} {imports or '-'}" for name, (imports, _) in reversed(LAYERS.items()))
    assert rows in page
    assert [name for name, (_, subject) in LAYERS.items() if f"- `{name}`: {subject}" not in page] == []


def test_ros_is_imported_by_its_folders_alone_and_no_import_is_relative() -> None:
    wrong = []
    for path in FILES:
        for name in imported(path):
            if name.startswith(".") or (is_ros(name) and layer_of(path) not in ROS_FOLDERS):
                wrong.append(f"{path.relative_to(PACKAGE)}: {name}")
    assert not wrong


@pytest.mark.parametrize(
    ("layer", "floors"),
    [
        ("io", IO_FLOORS),
        ("localisation", LOCALISATION_FLOORS),
        ("metrics", METRICS_FLOORS),
        ("nodes", NODE_FLOORS),
        ("suite", SUITE_FLOORS),
    ],
)
def test_folders_of_a_layer_import_lower_folders_alone(layer: str, floors: Sequence[set[str]]) -> None:
    floor = {folder: number for number, folders in enumerate(floors) for folder in folders}
    wrong = []
    for path in (PACKAGE / layer).rglob("*.py"):
        first = path.relative_to(PACKAGE / layer).parts[0].removesuffix(".py")
        own = first if first in floor else ""
        assert own in floor or first == "__init__", f"{path.relative_to(PACKAGE)} is on no floor"
        for name in imported(path):
            head, _, rest = name.partition(f"{NAME}.{layer.replace('/', '.')}.")
            folder = rest.split(".")[0] if rest.split(".")[0] in floor else ""
            if not head and rest and own != folder and floor[own] <= floor[folder]:
                wrong.append(f"{path.relative_to(PACKAGE)}: {name}")
    assert not wrong


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
