"""The tests of the localiser form one group for pytest-xdist: its kernels are compiled in one process, not in each."""

from itertools import islice
from pathlib import Path

import pytest

from helpers import ROOT
from sfr_loc_map.evidence.localiser_runs import PairsInMemory
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import drive_of

HERE = Path(__file__).parent
SAMPLE_PAIRS = 110


@pytest.fixture(scope="session")
def sample() -> PairsInMemory:
    """The first pairs of the sample, decoded once."""
    source = drive_of(open_source(ROOT / "sample" / "sample.mcap"))
    return PairsInMemory(source.rig, [*islice(source.pairs(), SAMPLE_PAIRS)], source.ground_truth)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of this folder."""
    for item in items:
        if item.path.is_relative_to(HERE):
            item.add_marker(pytest.mark.xdist_group("localisation"))
