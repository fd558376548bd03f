"""A small data set."""

import pytest

from helpers.made_worlds import World, make_world


@pytest.fixture
def world() -> World:
    """Both tasks, noise images, awkward numbers."""
    return make_world()
