"""Sources that are written once for all tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Callable[[Path], Path]], Path]:
    """`made_once(make)`: the source that `make` writes, made once for all tests, which only read it."""
    made: dict[str, Path] = {}

    def source(make: Callable[[Path], Path]) -> Path:
        if make.__name__ not in made:
            made[make.__name__] = make(tmp_path_factory.mktemp(make.__name__) / "source")
        return made[make.__name__]

    return source
