"""Makes the helpers beside the tests importable, and gives small data sets."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from made_worlds import World, make_world, write_folder


@pytest.fixture
def world() -> World:
    """Both tasks, noise images, awkward numbers."""
    return make_world()


@pytest.fixture
def folder(tmp_path: Path, world: World) -> Path:
    """The world as a data set folder with loc/ and nav/."""
    return write_folder(tmp_path / "folder", world)
