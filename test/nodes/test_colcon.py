"""The package builds in a colcon workspace and its executables run from there, as `ros2 run` starts them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("colcon_core", reason="colcon is not installed: pip install colcon-common-extensions")
pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
PACKAGE = "sfr_loc_map"
PARTS = ("sfr_loc_map", "config", "launch_scripts", "scripts", "resource", "setup.py", "setup.cfg", "package.xml")
LEFT_OUT = shutil.ignore_patterns("__pycache__", "*.egg-info")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("workspace")
    package = folder / "src" / PACKAGE
    package.mkdir(parents=True)
    for name in (*PARTS, "README.md", "pyproject.toml", "LICENSE", "MANIFEST.in"):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, package / name, ignore=LEFT_OUT)
        elif source.exists():
            shutil.copy(source, package / name)
        else:
            assert name not in PARTS, name
    command = [sys.executable, "-m", "colcon", "build", "--event-handlers", "console_direct+"]
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=200, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder / "install" / PACKAGE


def test_what_ros2_run_and_launch_look_for_is_installed(workspace: Path) -> None:
    marker = workspace / "share" / "ament_index" / "resource_index" / "packages" / PACKAGE
    assert marker.is_file()
    executables = {path.name for path in (workspace / "lib" / PACKAGE).iterdir()}
    assert executables >= {"localisation_node", "mapping_node", "monitor_node"}
    share = workspace / "share" / PACKAGE
    for name in ("localisation", "replay", "sfr"):
        assert (share / "launch_scripts" / f"{name}.launch.py").is_file()
    for path in (ROOT / "config").rglob("*.yaml"):
        assert (share / "config" / path.relative_to(ROOT / "config")).read_bytes() == path.read_bytes()


def test_an_executable_runs_from_the_workspace(workspace: Path, tmp_path: Path) -> None:
    packages = next((workspace / "lib").glob("python3*/site-packages"))
    environment = os.environ | {"PYTHONPATH": str(packages), "ROS_LOG_DIR": str(tmp_path)}
    place = [sys.executable, "-c", f"import {PACKAGE}; print({PACKAGE}.__file__)"]
    where = subprocess.run(place, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert Path(where.stdout.strip()).is_relative_to(packages)
    node = [sys.executable, str(workspace / "lib" / PACKAGE / "localisation_node")]
    wrong = ["--ros-args", "-p", "localisation.max_featurs:=300"]
    done = subprocess.run([*node, *wrong], env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "max_features" in done.stderr + done.stdout  # the likely name is told
