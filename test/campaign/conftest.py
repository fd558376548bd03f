"""Makes the modules beside the tests importable, and keeps each test in a ROS domain of its own."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from sfr_loc_map.nodes import environment


@pytest.fixture(autouse=True)
def own_domain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(environment.free_domain()))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
    monkeypatch.setenv(environment.PROFILE_VARIABLE, str(environment.PROFILE))
    monkeypatch.delenv("ROS_LOCALHOST_ONLY", raising=False)
