"""A data set of a few pairs, localised and mapped once by the API."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

import sfr_loc_map as suite
from helpers.made_scene import write_folder


@pytest.fixture(scope="package")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("api") / "data", 6, 2)


@pytest.fixture(scope="package")
def estimate(folder: Path) -> suite.Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return suite.localise(folder, start="truth")


@pytest.fixture(scope="package")
def cloud(folder: Path) -> suite.PointCloud:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return suite.map(suite.open(folder))
