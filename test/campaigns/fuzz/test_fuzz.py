"""The fuzzer detects every kind of failure and is reproducible; the readers handle a sample of its inputs."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

import pytest

from campaigns.fuzz.inputs import Campaign, Target, make_input, run_input
from campaigns.fuzz.targets import TARGETS, make_world
from sfr_loc_map.errors import InputError

SEED = 20
COSTLY = {"localisation config", "JPEG", "mcap", "sqlite3", "metadata.yaml", "ROS 1 bag"}
"""Targets that take more than 0.1 s per input, or have sufficient tests elsewhere."""
SLICE = [target for target in TARGETS if target.name not in COSTLY]


@pytest.mark.slow
def test_a_slice_of_the_inputs_is_accepted_or_refused(tmp_path: Path) -> None:
    found, world = [], make_world(tmp_path / "world")
    for target in SLICE:
        outcome = run_input(target, make_input(target, world, SEED, 1), world, tmp_path / "out")
        found += [] if outcome.good else [f"{target.name}: {outcome.kind}: {outcome.text}"]
    assert not found
    for target in SLICE[:8]:
        first, again, other = (make_input(target, world, seed, 3) for seed in (1, 1, 2))
        assert first == again
        assert first != other


def _fail(error: Exception) -> None:
    raise error


def _hang() -> None:
    while True:
        pass


FAILURES = {
    "Segmentation fault": lambda: ctypes.string_at(0),
    "_hang": _hang,  # killed by the time limit, with a stack trace
    "memory": lambda: b"x" * 600_000_000,
    "nobody expects it": lambda: _fail(KeyError("nobody expects it")),
    "control characters": lambda: print("\x1b[31m", file=sys.stderr),
    "refused": lambda: _fail(InputError("it is not valid")),
}


def made_targets() -> dict[str, Target]:
    """Return readers that fail in every way, named after the expected text."""

    def reader(name: str, path: Path) -> None:
        if path.read_bytes() != b"valid":
            FAILURES[name]()

    return {
        name: Target(name, "file", (lambda _rng, _data: b"corrupted",), (lambda path, name=name: reader(name, path),))
        for name in FAILURES
    }


@pytest.mark.slow
def test_every_kind_of_failure_is_noticed_and_kept(tmp_path: Path) -> None:
    world = tmp_path / "world"
    world.mkdir()
    (world / "file").write_bytes(b"valid")
    campaign = Campaign(world, tmp_path / "out", 1, f"{__name__}:made_targets", cpu_s=1.5)
    campaign.run(list(FAILURES), len(FAILURES), 100.0)
    assert campaign.outcomes["refused", "refused"] == 1
    assert len(campaign.failures) == len(FAILURES) - 1
    for (file, outcome), name in zip(campaign.failures.items(), FAILURES, strict=False):
        assert name in outcome.kind + outcome.text
        assert file.read_bytes() == b"corrupted"
        assert str(file) in file.with_suffix(".txt").read_text()
