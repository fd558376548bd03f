"""Association of stamps: one to one, the nearest first, against the plainest search."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfr_loc_map.metrics.association import bracketed, decide_mode, match_stamps, unique_rows
from sfr_loc_map.metrics.config import AssociationMode

STAMPS = st.lists(st.integers(0, 60), max_size=25, unique=True).map(lambda s: np.array(sorted(s), np.int64))


@settings(max_examples=200)
@given(STAMPS, STAMPS, st.integers(0, 5))
def test_each_truth_is_used_once_and_within_the_tolerance(est: np.ndarray, gt: np.ndarray, tolerance: int) -> None:
    partner = match_stamps(est, gt, tolerance)
    used = partner[partner >= 0]
    assert len(set(used.tolist())) == len(used)
    assert (np.abs(est[partner >= 0] - gt[used]) <= tolerance).all()
    free_gt = sorted(set(range(len(gt))) - set(np.searchsorted(gt, np.intersect1d(est, gt)).tolist()))
    rivals = [s for s in est.tolist() if s not in gt]
    for stamp, index in zip(est.tolist(), partner.tolist(), strict=True):
        if stamp in gt:
            assert gt[index] == stamp, "equal stamps belong together"
        elif free_gt:
            nearest = min(free_gt, key=lambda k: (abs(int(gt[k]) - stamp), k))
            first = min(rivals, key=lambda s: (abs(int(gt[nearest]) - s), s))
            wins = abs(int(gt[nearest]) - stamp) <= tolerance and first == stamp
            assert index in ((nearest,) if wins else (-1, nearest)), "the nearest of all gets it"


@settings(max_examples=100)
@given(st.lists(st.integers(0, 20), max_size=30))
def test_of_one_stamp_the_last_counts(stamps: list[int]) -> None:
    rows = unique_rows(np.array(stamps, np.int64))
    last = {stamp: row for row, stamp in enumerate(stamps)}
    assert rows.tolist() == [last[stamp] for stamp in sorted(last)]


def test_estimates_between_true_poses_are_bracketed() -> None:
    est, gt = np.array([5, 10, 15, 35, 99]), np.array([0, 10, 20, 40, 50])
    between, after = bracketed(est, gt, match_stamps(est, gt, 0), 10)
    assert est[between].tolist() == [5, 15], "35 lies in a gap of 20, 99 after the end, 10 has its truth"
    assert gt[after].tolist() == [10, 20]


@pytest.mark.parametrize(
    ("est", "gt", "mode"),
    [
        (np.arange(100) * 10, np.arange(400) * 5, AssociationMode.MATCH),
        (np.arange(100) * 10, np.arange(100) * 10 + 3, AssociationMode.INTERPOLATE),
        (np.arange(100) * 10, np.arange(25) * 40, AssociationMode.MATCH),
        (np.arange(0), np.arange(5), AssociationMode.MATCH),
        (np.array([7]), np.arange(5) * 10, AssociationMode.INTERPOLATE),
    ],
)
def test_the_first_stamps_decide_the_mode(est: np.ndarray, gt: np.ndarray, mode: AssociationMode) -> None:
    assert decide_mode(est, gt, 0) is mode
