"""The version has one source, the metadata of pip and ROS agree, and a built package has all files."""

import ast
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from importlib.metadata import version
from pathlib import Path

import sfr_loc_map
from helpers import ROOT

ROSDEP_NAMES = {"opencv-python-headless": "python3-opencv", "pyyaml": "python3-yaml"}
NOT_IN_ROSDEP = {"lazy-loader", "msgspec", "rosbags", "setuptools", "simplejpeg"}


def requirements() -> dict[str, str]:
    """Return setup.py's `install_requires` by their names."""
    for node in ast.walk(ast.parse((ROOT / "setup.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.keyword) and node.arg == "install_requires":
            return {re.split(r"[<>=]", text)[0]: text for text in ast.literal_eval(node.value)}
    raise AssertionError("setup.py has no install_requires")


def test_version_is_the_same_everywhere() -> None:
    package = ET.parse(ROOT / "package.xml").getroot()
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    releases = re.findall(r"^## \[(\d+\.\d+\.\d+)\]", changelog, re.MULTILINE)
    assert package.findtext("version") == sfr_loc_map.__version__
    assert releases[0] == sfr_loc_map.__version__
    assert version("sfr_loc_map") == sfr_loc_map.__version__


def test_package_xml_names_what_setup_py_requires() -> None:
    package = ET.parse(ROOT / "package.xml").getroot()
    declared = {item.text for item in package.findall("exec_depend")}
    needed = requirements()
    assert {ROSDEP_NAMES.get(name, f"python3-{name}") for name in needed.keys() - NOT_IN_ROSDEP} <= declared
    for file in ("package.xml", "README.md"):  # what no rosdep key brings has one command
        command = (ROOT / file).read_text(encoding="utf-8")
        assert all(f'"{needed[name]}"' in command for name in NOT_IN_ROSDEP - {"setuptools"}), file


def test_a_built_package_has_all_files_of_the_package(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "setup.py", "-q", "build_py", "--build-lib", tmp_path], cwd=ROOT, check=True)
    package = ROOT / "sfr_loc_map"
    files = {
        path.relative_to(ROOT) for path in package.rglob("*") if path.is_file() and "__pycache__" not in path.parts
    }
    assert files <= {path.relative_to(tmp_path) for path in tmp_path.rglob("*")}
