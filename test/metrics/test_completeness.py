"""What of a drive is covered, on drives of which parts are left out."""

import numpy as np
import pytest

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score import Completeness
from sfr_loc_map.metrics.trajectory_score import score_trajectory

SECOND = 1_000_000_000
COUNT = 401


def straight(first: int = 0, last: int = COUNT, every: int = 1) -> Trajectory:
    """A drive of 0.1 m/s along x at 10 Hz, of which every n-th pose from first to last is there."""
    rows = np.arange(first, last, every)
    positions = np.column_stack([0.01 * rows, np.zeros((len(rows), 2))])
    return Trajectory(rows * SECOND // 10, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1)))


def covered(estimate: Trajectory, truth: Trajectory, images: Trajectory | None = None) -> Completeness:
    stamps = None if images is None else images.stamps_ns
    config = TrajectoryScoreConfig(conditions=("distance=2",))
    made = score_trajectory(Estimates.of(estimate), truth, config, image_stamps_ns=stamps).score.completeness
    assert made is not None
    return made


@pytest.mark.clause("4.1.1")
def test_half_a_drive_is_not_the_whole() -> None:
    for images in (None, straight()):
        half = covered(straight(last=201), straight(), images)
        assert half.judged_share == pytest.approx(0.5, abs=0.003)
        assert half.missing == 200
        assert half.longest_gap_m == pytest.approx(2.0)
        assert half.incomplete is not None
        whole = covered(straight(), straight(), images)
        assert (whole.judged_share, whole.missing, whole.incomplete) == (1.0, 0, None)


def test_truth_denser_than_the_images_is_covered() -> None:
    dense = covered(straight(every=10), straight())
    assert (dense.judged_share, dense.incomplete) == (1.0, None)


def test_truth_that_goes_on_after_the_images_needs_them_to_be_known() -> None:
    part = straight(100, 300)
    assert covered(part, straight()).incomplete is not None
    assert covered(part, straight(), part).incomplete is None


def test_truth_sparser_than_the_images_is_covered() -> None:
    for images in (None, straight()):
        made = covered(straight(), straight(every=5), images)
        assert (made.matched, made.judged_share, made.incomplete) == (81, 1.0, None)
        assert made.unmatched_estimates == COUNT - 81


def test_one_hole_longer_than_a_condition_is_named_whatever_its_share() -> None:
    long = straight(last=100_001)
    keep = np.ones(100_001, np.bool_)
    keep[5000:5250] = False
    holed = Trajectory(long.stamps_ns[keep], long.positions[keep], long.quats_xyzw[keep])
    for images in (None, long):
        made = covered(holed, long, images)
        assert made.missing_share < 0.01
        assert made.incomplete is not None
        assert "2.51 m" in made.incomplete
        keep[5000:5250:2] = True
        sparse = Trajectory(long.stamps_ns[keep], long.positions[keep], long.quats_xyzw[keep])
        assert covered(sparse, long, images).incomplete is None
        keep[5000:5250] = False


def test_two_runs_in_one_file_are_refused() -> None:
    first, second = straight(), straight()
    both = Trajectory(
        np.concatenate([first.stamps_ns, second.stamps_ns]),
        np.concatenate([first.positions, second.positions + np.array([100.0, 0.0, 0.0])]),
        np.concatenate([first.quats_xyzw, second.quats_xyzw]),
    )
    with pytest.raises(MetricsError, match="two runs"):
        covered(both, first)
    twice = Trajectory(both.stamps_ns, np.tile(first.positions, (2, 1)), both.quats_xyzw)
    assert covered(twice, first).doubled_stamps == COUNT
