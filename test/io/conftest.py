"""Makes the helpers beside the tests importable, and gives a small data set."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from made_worlds import World, make_world


@pytest.fixture
def world() -> World:
    """Both tasks, noise images, awkward numbers."""
    return make_world()
