"""The fuzzer notices every kind of failure, repeats itself, and a slice of its inputs is taken by the readers."""

from __future__ import annotations

from pathlib import Path

import pytest
from campaign import Campaign
from execution import make_input, run_input
from made_failures import FAILURES
from targets import TARGETS
from world import make_world

SEED = 20
COSTLY = {"localisation config", "arguments", "JPG", "mcap", "mcap of JPEG", "sqlite3", "metadata.yaml", "resume file"}
COSTLY |= {"ROS 1 bag"}
"""What takes more than a tenth of a second each, or has tests enough elsewhere."""
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


@pytest.mark.slow
def test_every_kind_of_failure_is_noticed_and_kept(tmp_path: Path) -> None:
    world = tmp_path / "world"
    world.mkdir()
    (world / "file").write_bytes(b"valid")
    campaign = Campaign(world, tmp_path / "out", 1, "made_failures:made_targets")
    campaign.run(list(FAILURES), len(FAILURES), 100.0, cpu_s=1.5)
    assert campaign.outcomes["refused", "refused"] == 1
    assert len(campaign.failures) == len(FAILURES) - 1
    for (file, outcome), name in zip(campaign.failures.items(), FAILURES, strict=False):
        assert name in outcome.kind
        assert file.read_bytes() == b"corrupted"
        assert str(file) in file.with_suffix(".txt").read_text()
