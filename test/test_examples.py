"""The example configurations name what the nodes publish; the programs they are for are not run here."""

from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "config" / "examples"
TYPES = {"Map": "nav_msgs/OccupancyGrid", "PointCloud2": "sensor_msgs/PointCloud2"}


def read(name: str) -> Any:
    return yaml.safe_load((EXAMPLES / name).read_text(encoding="utf-8"))


def topics() -> dict[str, str]:
    """Return the types of the topics of docs/interfaces.md."""
    rows = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in row.split("|")[1:3]] for row in rows if row.startswith("| `")]
    return {name.strip("`"): kind for name, kind in cells}


def test_rviz_shows_topics_that_are_published_with_their_durability() -> None:
    shown = [item for item in read("sfr.rviz")["Visualization Manager"]["Displays"] if "Topic" in item]
    assert len(shown) == 5
    for item in shown:
        name, kind = item["Topic"]["Value"], item["Class"].split("/")[1]
        assert topics()[name] == TYPES.get(kind, f"nav_msgs/{kind}")
        assert (item["Topic"]["Durability Policy"] == "Transient Local") == (name != "localisation/odometry")


@pytest.mark.parametrize("path", sorted(EXAMPLES.iterdir()), ids=lambda path: path.name)
def test_examples_are_installed_and_described(path: Path) -> None:
    assert f'glob("config/examples/*{path.suffix}")' in (ROOT / "setup.py").read_text(encoding="utf-8")
    assert path.name in (ROOT / "docs" / "integration.md").read_text(encoding="utf-8")
