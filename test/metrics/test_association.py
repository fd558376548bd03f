"""Association of stamps: one to one, the nearest first, against the plainest search."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import AssociationConfig, AssociationMode
from sfr_loc_map.metrics.frames.association import (
    Estimates,
    Frames,
    MatchedStamps,
    associate,
    rows_of_images,
    unique_rows,
)

STAMPS = st.lists(st.integers(0, 60), max_size=25, unique=True).map(lambda s: np.array(sorted(s), np.int64))


def poses(stamps: Any) -> Trajectory:
    """Poses whose x is their number."""
    x = np.arange(len(stamps), dtype=np.float64)[:, None] * [1.0, 0.0, 0.0]
    return Trajectory(np.asarray(stamps, np.int64), x, np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1)))


def associated(
    est: Any, gt: Any, mode: str = "match", tolerance: int = 0, gap: int = 10
) -> tuple[Frames, MatchedStamps]:
    config = AssociationConfig(truth=mode, tolerance_s=tolerance * 1e-9, max_gap_s=gap * 1e-9)
    return associate(poses(est), poses(gt), config)


@settings(max_examples=60)
@given(STAMPS, STAMPS, st.integers(0, 5))
def test_each_truth_is_used_once_and_within_the_tolerance(est: np.ndarray, gt: np.ndarray, tolerance: int) -> None:
    frames, counts = associated(est, gt, tolerance=tolerance)
    partner = dict(
        zip(est[frames.estimate_rows].tolist(), frames.true_position[:, 0].astype(int).tolist(), strict=True)
    )
    assert len(set(partner.values())) == len(partner) == counts.exact + counts.near
    assert list(partner) == sorted(partner)
    assert list(partner.values()) == sorted(partner.values())
    common = np.intersect1d(est, gt)
    free_gt = sorted(set(range(len(gt))) - set(np.searchsorted(gt, np.intersect1d(est, gt)).tolist()))
    rivals = [s for s in est.tolist() if s not in gt]
    for stamp in est.tolist():
        index = partner.get(stamp)
        if stamp in gt:
            assert gt[index] == stamp, "equal stamps belong together"
        elif free_gt:
            nearest = min(free_gt, key=lambda k: (abs(int(gt[k]) - stamp), k))
            first = min(rivals, key=lambda s: (abs(int(gt[nearest]) - s), s))
            is_across = np.searchsorted(common, stamp) != np.searchsorted(common, gt[nearest])
            near = abs(int(gt[nearest]) - stamp) <= tolerance and not is_across
            assert index == nearest if near and first == stamp else index in (None, nearest)
            assert index is None or near


@settings(max_examples=60)
@given(STAMPS, STAMPS, st.integers(0, 10), st.sampled_from(["match", "interpolate"]))
def test_frames_and_their_estimates_are_in_time_order(
    est: np.ndarray, gt: np.ndarray, tolerance: int, mode: str
) -> None:
    frames, _ = associated(est, gt, mode, tolerance)
    assert (np.diff(frames.stamps_ns) > 0).all()
    assert (np.diff(est[frames.estimate_rows]) > 0).all()


def test_an_estimate_is_not_matched_across_equal_stamps() -> None:
    """The true pose at 45 is nearer to the estimate at 36 than that at 20, but the frame at 40 lies between them."""
    est, gt = [0, 20, 36, 40, 60, 80], [0, 20, 40, 45, 60, 80]
    assert associated(est, gt, "match", 10)[0].stamps_ns.tolist() == [0, 20, 40, 60, 80]
    frames = associated(est, gt, "interpolate", 10, gap=20)[0]
    assert frames.stamps_ns.tolist() == est
    assert frames.estimate_rows.tolist() == list(range(6))


@settings(max_examples=60)
@given(st.lists(st.integers(0, 20), max_size=30))
def test_of_one_stamp_the_last_counts(stamps: list[int]) -> None:
    last = {stamp: row for row, stamp in enumerate(stamps)}
    wanted = [last[stamp] for stamp in sorted(last)]
    assert unique_rows(np.array(stamps, np.int64)).tolist() == wanted
    frames, counts = associated(stamps, range(21))
    assert frames.estimate_rows.tolist() == wanted
    assert counts.estimate_duplicates == len(stamps) - len(wanted)


def test_estimates_between_true_poses_get_interpolated_truth() -> None:
    frames, counts = associated([5, 10, 15, 35, 99], [0, 10, 20, 40, 50], "interpolate")
    assert frames.stamps_ns.tolist() == [5, 10, 15], "35 lies in a gap of 20, 99 after the end"
    assert frames.true_position[:, 0].tolist() == [0.5, 1.0, 1.5]
    assert (counts.exact, counts.interpolated, counts.largest_gap_ns) == (1, 2, 10)


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
    assert associated(est, gt, "auto")[1].mode is mode


@pytest.mark.parametrize(("every", "mode"), [(3, AssociationMode.MATCH), (6, AssociationMode.INTERPOLATE)])
def test_auto_matches_if_a_quarter_of_the_stamps_have_a_partner(every: int, mode: AssociationMode) -> None:
    """Every third or every sixth estimate has the stamp of a true pose; the others lie between two true poses."""
    gt = np.arange(0, 600, 10)
    est = gt[:-1] + np.where(np.arange(len(gt) - 1) % every == 0, 0, 5)
    assert associated(est, gt, "auto")[1].mode is mode


def test_of_several_estimates_near_an_image_the_nearest_is_a_frame() -> None:
    """An item under test may publish more poses where the estimate is good, or at a higher rate throughout."""
    images, config = np.arange(5) * 100, AssociationConfig(truth="interpolate")
    given = poses([0, 30, 99, 101, 150, 210, 230, 300, 399, 400, 430])
    frames, counts = associate(given, poses(np.arange(11) * 50), config, images)
    assert given.stamps_ns[frames.estimate_rows].tolist() == [0, 99, 210, 300, 400]
    assert (len(frames.stamps_ns), counts.estimate_duplicates) == (5, 0)
    beside = poses(images[:4] + 45)
    of_other_clock, _ = associate(beside, poses(np.arange(11) * 50), config, images)
    assert len(of_other_clock.stamps_ns) == 4


@pytest.mark.parametrize(
    ("stamps_ns", "expected"),
    [
        ([0, 100, 200], [0, 1, 2]),
        ([1, 40, 60, 99, 198], [0, 3, 4]),  # 40 and 60 ns are between the images
        ([1, 99, 240], [0, 1]),  # 240 ns is the nearest estimate to the last image, but not near it
        ([95, 98, 103], [1]),  # the nearest of several estimates
        ([50, 150], [0, 1]),  # another clock: no estimate is near an image
    ],
)
def test_estimates_between_the_images_are_no_frames(stamps_ns: list[int], expected: list[int]) -> None:
    images_ns = np.array([0, 100, 200], np.int64)
    rows = rows_of_images(np.array(stamps_ns, np.int64), np.arange(len(stamps_ns)), images_ns, near_ns=5)
    assert rows.tolist() == expected


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"lost": np.zeros(2, np.bool_)}, r"'lost' .* has the shape \(2,\): \(3,\) is required for 3 poses"),
        ({"lost": ["no", "no", "yes"]}, "'lost' .* has the type <U3: true or false"),
        ({"degraded": [0, 1, 0]}, "'degraded' .* true or false"),
        ({"covariance": np.zeros((4, 21))}, "'covariance'"),
        ({"covariance": np.zeros((3, 36))}, r"\(3, 21\) is required"),
        ({"covariance": np.zeros((3, 6, 6))}, r"\(3, 21\) is required"),
        ({"steps": np.zeros((3, 21))}, r"\(3, 48\) is required"),
    ],
)
def test_columns_of_another_shape_or_type_are_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(MetricsError, match=words):
        Estimates.of(poses([0, 10, 20]), **given)


def test_rows_of_estimates_keep_their_columns() -> None:
    lost = np.array([True, False, False])
    covariance = np.arange(63.0).reshape(3, 21)
    chosen = Estimates.of(poses([0, 10, 20]), lost, covariance=covariance).at_rows(np.array([2, 0]))
    assert chosen.trajectory.stamps_ns.tolist() == [20, 0]
    assert chosen.lost.tolist() == [False, True]
    assert chosen.is_lost_known.all()
    assert not chosen.is_degraded_known.any()
    assert chosen.covariance is not None
    assert chosen.covariance.tolist() == covariance[[2, 0]].tolist()
    assert chosen.steps is None
