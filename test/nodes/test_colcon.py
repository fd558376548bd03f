"""The package builds in a colcon workspace, copied and linked, and runs from there as by `ros2 run`."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from helpers import ROOT

pytest.importorskip("colcon_core", reason="colcon is not installed: pip install colcon-common-extensions")

PACKAGE = "sfr_loc_map"
PARTS = ("sfr_loc_map", "config", "launch_scripts", "scripts", "resource", "setup.py", "setup.cfg", "package.xml")
PARTS += ("README.md", "pyproject.toml", "LICENSE")
WAYS = {"copied": [], "linked": ["--symlink-install"]}


@pytest.fixture(scope="module")
def workspaces(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the folders that the package was installed into, by the way, built side by side."""
    folder = tmp_path_factory.mktemp("workspace")
    package = folder / "src" / PACKAGE
    package.mkdir(parents=True)
    for name in PARTS:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, package / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, package / name)
    builds = {}
    for way, options in WAYS.items():
        bases = ["--base-paths", "src", "--build-base", f"build_{way}", "--install-base", f"install_{way}"]
        words = ["--log-base", f"log_{way}", "build", "--event-handlers", "console_direct+", *bases, *options]
        with (folder / f"{way}.log").open("w") as log:
            builds[way] = subprocess.Popen([sys.executable, "-m", "colcon", *words], cwd=folder, stdout=log, stderr=log)
    for way, build in builds.items():
        assert build.wait(200) == 0, (folder / f"{way}.log").read_text()
    return {way: folder / f"install_{way}" for way in WAYS}


@pytest.fixture(params=WAYS)
def installed(workspaces: dict[str, Path], request: pytest.FixtureRequest) -> Path:
    return workspaces[request.param]


def test_what_ros2_run_and_launch_look_for_is_installed(installed: Path) -> None:
    inner = installed / PACKAGE
    assert (inner / "share" / "ament_index" / "resource_index" / "packages" / PACKAGE).is_file()
    executables = {path.name for path in (inner / "lib" / PACKAGE).iterdir()}
    assert executables >= {"localisation_node", "mapping_node", "monitor_node", "sfr"}
    share = inner / "share" / PACKAGE
    for name in ("node", "sfr"):
        assert (share / "launch_scripts" / f"{name}.launch.py").is_file()
    for path in (ROOT / "config").rglob("*.yaml"):
        assert (share / "config" / path.relative_to(ROOT / "config")).read_bytes() == path.read_bytes()
    profile = ROOT / PACKAGE / "ros" / "profiles" / "fastdds_shm.xml"
    assert (share / "config" / "fastdds_shm.xml").read_bytes() == profile.read_bytes()


def test_an_executable_runs_from_the_workspace(installed: Path, tmp_path: Path) -> None:
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {
        "ROS_LOG_DIR": str(tmp_path)
    }

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        """Run Python as a shell does that has sourced the workspace."""
        shell = ["sh", "-c", '. "$0/local_setup.sh" && exec "$@"', str(installed), sys.executable, *words]
        return subprocess.run(
            shell, env=variables, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
        )

    where = run("-c", f"import {PACKAGE}; print({PACKAGE}.__file__)")
    assert Path(where.stdout.strip()).is_relative_to(installed.parent), where.stderr
    node = str(installed / PACKAGE / "lib" / PACKAGE / "localisation_node")
    done = run(node, "--ros-args", "-p", "localisation.max_featurs:=300")
    assert done.returncode == 2
    assert "max_features" in done.stderr + done.stdout  # the likely name is told
