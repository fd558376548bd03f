"""Random faults of `make random-faults` are faults that can be injected, in the order in which they happen."""

from __future__ import annotations

import numpy as np
from localisation.random_faults import AMOUNTS, random_faults

from sfr_loc_map.simulation.faults import parse_fault


def test_random_faults_are_valid_ordered_and_repeat_with_their_seed() -> None:
    order, seen = list(AMOUNTS), set()
    for seed in range(300):
        text = random_faults(np.random.default_rng(seed), 60)
        assert text == random_faults(np.random.default_rng(seed), 60)
        kinds = [parse_fault(part).kind for part in text.split("+")]
        assert kinds == sorted(set(kinds), key=order.index)
        seen |= set(kinds)
    assert seen == set(AMOUNTS)
