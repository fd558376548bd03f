"""The sign-flip test and its correction against plain counting and worked examples."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sfr_loc_map.metrics.statistics import holm
from sfr_loc_map.suite.sign_flip import EXACT_DRIVES, sign_flip_p


def test_exact_probability_is_that_of_all_signs() -> None:
    logs = np.array([0.3, -0.1, 0.2, 0.5, 0.05, 0.4, -0.02])
    sums = [abs(sum(s * v for s, v in zip(signs, logs, strict=True))) for signs in itertools.product((1, -1), repeat=7)]
    expected = np.mean([value >= abs(logs.sum()) - 1e-12 for value in sums])
    assert sign_flip_p(logs) == pytest.approx(expected)


def test_all_drives_alike_give_the_smallest_probability() -> None:
    assert sign_flip_p(np.full(8, 0.1)) == 2 / 2**8
    assert sign_flip_p(np.full(5, 0.1)) is None
    assert sign_flip_p(np.zeros(9)) == 1.0


@pytest.mark.parametrize("drives", [EXACT_DRIVES - 4, EXACT_DRIVES + 6])
def test_without_a_difference_it_is_below_a_level_as_often_as_the_level(drives: int) -> None:
    rng = np.random.default_rng(drives)
    found = np.array([sign_flip_p(rng.normal(0.0, 0.2, drives)) for _ in range(150)])
    assert 0.01 <= np.mean(found < 0.1) <= 0.19
    assert np.mean(found < 0.002) <= 0.02


def test_holm_is_as_in_the_text() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, None, 0.9]) == pytest.approx([1.0, None, 1.0])
    assert holm([]) == []
