"""Libraries of candidates, compiled once."""

from collections.abc import Callable
from pathlib import Path

import pytest

from helpers import HELPERS, ROOT
from helpers.compile_c import LIBRARY, compile_c
from helpers.made_scene import write_folder

Build = Callable[..., Path]


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """`build(source, option...)`: the library of a source in C, or with `-o` as option a program."""
    folder = tmp_path_factory.mktemp("libraries")

    def made(*sources: Path, name: str, options: tuple[str, ...] = LIBRARY) -> Path:
        return compile_c(*sources, output=folder / name, options=options)

    return made


@pytest.fixture(scope="session")
def faulty(build: Build) -> Path:
    """The library that does at one pair what its configuration says."""
    return build(HELPERS / "faulty_candidate.c", name="libfaulty.so")


@pytest.fixture(scope="session")
def example(build: Build) -> Path:
    """The example candidate in C."""
    return build(ROOT / "examples/c_candidate/candidate.c", name="libcandidate.so")


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 12 pairs and a panorama of two."""
    return write_folder(tmp_path_factory.mktemp("methods") / "source", 12, 2)
