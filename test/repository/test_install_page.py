"""The commands of docs/install.md work on a system whose Python refuses pip (PEP 668)."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from helpers import ROOT

SYSTEM = Path("/usr/bin/python3")
LIBRARIES = "~/sfr_libraries"


def section(title: str) -> list[str]:
    """Return the commands of a section of the page."""
    text = (ROOT / "docs" / "install.md").read_text().partition(f"## {title}\n")[2].partition("\n## ")[0]
    return re.findall(r"^\$ (.*)$", text, re.MULTILINE)


def refuses_pip() -> bool:
    """Whether the Python of the system refuses to install."""
    command = [str(SYSTEM), "-m", "pip", "install", "--dry-run", "--no-index", "pip"]
    done = subprocess.run(command, capture_output=True, text=True, check=False) if SYSTEM.exists() else None
    return done is not None and "externally-managed-environment" in done.stderr


def test_every_pip_of_the_workspace_is_that_of_an_environment_that_sees_ros() -> None:
    commands = section("colcon")
    made = commands.index(f"python3 -m venv --system-site-packages {LIBRARIES}")
    users = [command for command in commands if re.search(r"\bpip\b|\bcolcon build\b", command)]
    assert len(users) == 3
    for command in users:
        assert command.startswith(f"{LIBRARIES}/bin/")
        assert commands.index(command) > made
    dockerfile = (ROOT / "docker" / "Dockerfile").read_text()
    for part in ("--system-site-packages", '"numpy<2" colcon-common-extensions ./src/sfr_loc_map', "-m colcon build"):
        assert part in dockerfile
        assert any(part in command for command in commands)


@pytest.mark.slow
def test_the_environment_of_the_page_installs_where_the_system_refuses(tmp_path: Path) -> None:
    if not refuses_pip():
        pytest.skip("the Python of this system does not refuse pip")
    folder = tmp_path / "libraries"
    (making,) = (command for command in section("colcon") if " -m venv " in command)
    words = making.replace("python3", str(SYSTEM)).replace(LIBRARIES, str(folder)).split()
    subprocess.run(words, check=True, capture_output=True)
    subprocess.run([folder / "bin" / "pip", "install", "--dry-run", "--no-index", "pip"], check=True)
    code = "import sys; print(any(path.endswith('dist-packages') for path in sys.path))"
    seen = subprocess.run([folder / "bin" / "python", "-c", code], capture_output=True, text=True, check=True)
    assert seen.stdout.strip() == "True"


def test_the_installation_of_the_demo_has_the_live_page() -> None:
    recipe = (ROOT / "Makefile").read_text().partition("\n$(STAMP): $(CORE)\n")[2].partition("\n\n")[0]
    assert 'live]")' in recipe
