"""One source of the version; what installers of both kinds are told agrees."""

from __future__ import annotations

import ast
import re
import xml.etree.ElementTree as ET
from importlib.metadata import version
from pathlib import Path

import sfr_loc_map

ROOT = Path(__file__).resolve().parents[1]
ROSDEP_NAMES = {"opencv-python-headless": "python3-opencv", "pyyaml": "python3-yaml"}
NOT_IN_ROSDEP = {"lazy-loader", "rosbags", "setuptools", "simplejpeg"}


def requirements() -> set[str]:
    """Return the names of setup.py's `install_requires`."""
    for node in ast.walk(ast.parse((ROOT / "setup.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.keyword) and node.arg == "install_requires":
            return {re.split(r"[<>=]", text)[0] for text in ast.literal_eval(node.value)}
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
    wanted = {ROSDEP_NAMES.get(name, f"python3-{name}") for name in requirements() - NOT_IN_ROSDEP}
    assert wanted <= declared
    comment = (ROOT / "package.xml").read_text(encoding="utf-8")
    assert all(name in comment for name in NOT_IN_ROSDEP - {"setuptools"}), "package.xml says what pip must bring"
