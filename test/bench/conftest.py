"""Tiny sources for benchmarks."""

from __future__ import annotations

from pathlib import Path

import pytest
from made_scene import write_folder


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("bench") / "drive", 12, 0)


@pytest.fixture(scope="session")
def panorama(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("bench") / "panorama", 0, 2)


@pytest.fixture(scope="session")
def long_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("bench") / "long", 30, 0)
