"""What of a drive is covered, on drives of which parts are left out."""

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from helpers.random_drives import as_score
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.completeness.copies import spline_positions
from sfr_loc_map.metrics.completeness.drive import single_run_stamps
from sfr_loc_map.metrics.completeness.expected_items import (
    calls_completeness,
    due_stamps,
    live_completeness,
    map_completeness,
)
from sfr_loc_map.metrics.completeness.gaps import TruePath, path_without_images, true_path
from sfr_loc_map.metrics.config import AssociationConfig, CallKind, TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import Scope
from sfr_loc_map.metrics.frames.association import Estimates, associate
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.limits import INDEPENDENT_FOR_VERDICT
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.metrics.trajectory.truth_error import interpolation_errors

SECOND = 1_000_000_000
COUNT = 401


def straight(first: int = 0, last: int = COUNT, every: int = 1) -> Trajectory:
    """A drive of 0.1 m/s along x at 10 Hz, of which every n-th pose from first to last is there."""
    rows = np.arange(first, last, every)
    positions = np.column_stack([0.01 * rows, np.zeros((len(rows), 2))])
    return Trajectory(rows * SECOND // 10, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1)))


class Covered:
    """What a score says of completeness."""

    def __init__(self, score: Score) -> None:
        self.incomplete, self.matched = judged_by(score, None).incomplete, score.association.matched
        self.without_truth = score.number("images_without_truth", part="count")
        self.judged_share, self.missing_share = score.number("judged", part="drive"), score.number("missing")
        self.missing = score.number("missing", part="count")
        self.unmatched_estimates = score.number("unmatched", part="count")
        self.doubled_stamps = score.number("doubled", part="count")
        self.longest_gap_m = score.number("longest_gap", part="distance")
        self.longest_gap_s = score.number("longest_gap", part="time")


def covered(
    estimate: Trajectory, truth: Trajectory, images: Trajectory | None = None, condition: str = "distance=2"
) -> Covered:
    stamps = None if images is None else images.stamps_ns
    config = TrajectoryScoreConfig(conditions=(condition,))
    return Covered(as_score(score_trajectory(Estimates.of(estimate), truth, config, image_stamps_ns=stamps)))


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
    images = straight(every=10)
    dense = covered(images, straight(), images)
    assert (dense.judged_share, dense.missing, dense.incomplete) == (1.0, 0, None)


@pytest.mark.clause("4.1.1")
def test_poses_chosen_from_a_drive_are_not_the_drive() -> None:
    """Whoever chooses the poses does not choose what is expected: the images do or, without them, the truth."""
    for images in (None, straight()):
        for every in (20, 25):
            chosen = covered(straight(every=every), straight(), images)
            assert chosen.missing == COUNT - len(range(0, COUNT, every))
            assert chosen.judged_share == pytest.approx(1.0 / every, abs=0.003)


@pytest.mark.clause("4.1.1")
def test_images_without_a_truth_are_not_judged() -> None:
    half = covered(straight(), straight(last=201), straight())
    assert (half.missing, half.judged_share) == (0, pytest.approx(0.5, abs=0.005))
    assert half.without_truth == 199  # a true pose stands for one period after it


def test_a_drive_without_images_expects_no_estimate() -> None:
    """Half of the true path has no estimate, but the source is known to have no image."""
    config = TrajectoryScoreConfig(conditions=("distance=2",))
    images_ns = np.empty(0, np.int64)
    score = as_score(score_trajectory(Estimates.of(straight(last=201)), straight(), config, image_stamps_ns=images_ns))
    assert score.association.images == 0
    assert (score.figure("judged", part="drive").n, score.number("in_gaps")) == (0, None)
    assert judged_by(score, None).incomplete is None


def test_truth_that_goes_on_after_the_images_needs_them_to_be_known() -> None:
    part = straight(100, 300)
    assert covered(part, straight()).incomplete is not None
    assert covered(part, straight(), part).incomplete is None


def test_an_unknown_fraction_of_expected_items_is_not_complete() -> None:
    limits = parse_limits({"trajectory": [{"condition": "distance=2", "position_max_m": 1.0}]}, "limits")
    config = TrajectoryScoreConfig(conditions=("distance=2",))
    moved = straight()
    moved = Trajectory(moved.stamps_ns, 1.001 * moved.positions, moved.quats_xyzw)
    score = as_score(score_trajectory(Estimates.of(moved), straight(), config, image_stamps_ns=moved.stamps_ns))
    assert judged_by(score, limits).incomplete is None
    for name in ("missing", "images_without_truth", "poses_repeated", "poses_of_truth", "errors_of_truth"):
        figures = tuple(
            replace(row, value=None) if (row.figure, row.part) == (name, None) else row for row in score.figures
        )
        assert judged_by(replace(score, figures=figures), limits).incomplete is not None, name


def test_truth_sparser_than_the_images_is_covered() -> None:
    for images in (None, straight()):
        made = covered(straight(), straight(every=5), images)
        assert (made.matched, made.judged_share, made.incomplete) == (81, 1.0, None)
        assert made.unmatched_estimates == COUNT - 81


@pytest.mark.parametrize("images_known", [True, False])
def test_images_outside_of_an_interpolated_truth_are_not_judged(images_known: bool) -> None:
    """Their estimates are not frames, so that no figure contains their errors."""
    images, truth = straight(), straight(50, 351, every=50)
    config = AssociationConfig(truth="interpolate", max_gap_s=6.0)
    stamps = images.stamps_ns if images_known else None
    scored = score_trajectory(
        Estimates.of(images), truth, TrajectoryScoreConfig(association=config), image_stamps_ns=stamps
    )
    drive = Covered(as_score(scored))
    assert (drive.matched, drive.without_truth) == (301, 100)


def test_one_hole_longer_than_a_condition_is_named_whatever_its_share() -> None:
    long = straight(last=30_001)
    keep = np.ones(30_001, np.bool_)
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


@pytest.mark.parametrize(
    ("condition", "is_hidden"),
    [
        ("distance=2,time=20", True),
        ("distance=2,time=30", False),  # a sub-trajectory ends where both parts hold, after 30 s and 3 m
        ("time=20,distance=3", False),
        ("distance=2,frames=1000", True),  # the frames of a gap are unknown
        ("frames=10", False),
    ],
)
def test_a_gap_hides_a_combined_condition_if_it_is_longer_in_each_part(condition: str, is_hidden: bool) -> None:
    """A gap of 2.51 m and 25.1 s."""
    long = straight(last=30_001)
    keep = np.ones(30_001, np.bool_)
    keep[5000:5250] = False
    holed = Trajectory(long.stamps_ns[keep], long.positions[keep], long.quats_xyzw[keep])
    for images in (None, long):
        assert (covered(holed, long, images, condition).incomplete is not None) == is_hidden


def test_two_gaps_do_not_hide_together_what_neither_hides() -> None:
    """One gap of 2.51 m and 25.1 s, one of 0.01 m and 50.1 s, and a condition of 2 m and 30 s."""
    long = straight(last=100_001)
    positions = long.positions.copy()
    positions[7000:7500] = positions[6999]
    positions[7500:] -= positions[7500] - positions[7000] - np.array([0.01, 0.0, 0.0])
    keep = np.ones(100_001, np.bool_)
    keep[5000:5250] = keep[7000:7500] = False
    truth = Trajectory(long.stamps_ns, positions, long.quats_xyzw)
    holed = Trajectory(truth.stamps_ns[keep], positions[keep], truth.quats_xyzw[keep])
    assert covered(holed, truth, truth, "distance=2,time=30").incomplete is None


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


def along(stamp: int, stamps: list[int], travelled: list[float]) -> float:
    """Path at a stamp, found pose by pose."""
    for i in range(1, len(stamps)):
        if stamp <= stamps[i]:
            share = max(stamp - stamps[i - 1], 0) / (stamps[i] - stamps[i - 1])
            return travelled[i - 1] + share * (travelled[i] - travelled[i - 1])
    return travelled[-1]


def slow(estimate: list[int], stamps: list[int], x: list[float], images: list[int] | None) -> dict[str, float]:
    """The same by loops over the stamps, on a drive along x; it shares no code with the package."""
    travelled = [sum(abs(x[j] - x[j - 1]) for j in range(1, i + 1)) for i in range(len(x))]
    gaps, missing = [], 0
    needed = stamps if images is None else images
    open_since = last = None
    for image in needed:
        if image in estimate:
            if open_since is not None:
                gaps.append((open_since, image))
            open_since, last = None, image
        else:
            missing += 1
            if open_since is None:
                open_since = image if last is None else last
    if open_since is not None:
        gaps.append((open_since, needed[-1]))
    metres = [along(b, stamps, travelled) - along(a, stamps, travelled) for a, b in gaps]
    seconds = [(b - a) / SECOND for a, b in gaps]
    return {
        "missing": missing,
        "judged_share": 1.0 - missing / len(needed),
        "longest_gap_m": max(metres, default=0.0),
        "longest_gap_s": max(seconds, default=0.0),
    }


@settings(max_examples=50)
@given(st.integers(0, 10**6), st.integers(1, 4), st.booleans(), st.sampled_from(["distance=3", "time=2", "frames=4"]))
def test_random_holes_are_those_of_a_slow_loop(seed: int, denser: int, images_known: bool, condition: str) -> None:
    """Truth some times as dense as the images, which begin later and end earlier; holes of any length; it may stand."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(12, 90))
    stamps = (17 + np.arange(count) * SECOND // 10).astype(np.int64)
    x = np.cumsum(rng.uniform(0.0, 0.4, count) * (rng.random(count) < 0.7)) * (rng.random() < 0.9)
    first, last = rng.integers(0, 6), count - rng.integers(0, 6)
    images = stamps[first:last:denser]
    kept = np.ones(len(images), np.bool_)
    for _ in range(rng.integers(0, 4)):
        begin = rng.integers(0, len(images))
        kept[begin : begin + rng.integers(1, 12)] = False
    kept[rng.integers(0, len(images), 2)] = True
    estimated = images[kept]

    def poses(at: np.ndarray) -> Trajectory:
        rows = np.searchsorted(stamps, at)
        return Trajectory(at, np.column_stack([x[rows], np.zeros((len(at), 2))]), np.tile([0, 0, 0, 1.0], (len(at), 1)))

    scored = score_trajectory(
        Estimates.of(poses(estimated)),
        poses(stamps),
        TrajectoryScoreConfig(conditions=(condition,)),
        image_stamps_ns=images if images_known else None,
    )
    made = Covered(as_score(scored))
    expected = slow(estimated.tolist(), stamps.tolist(), x.tolist(), images.tolist() if images_known else None)
    for name, value in expected.items():
        assert getattr(made, name) == pytest.approx(value, abs=1e-9), name
    kind, value = condition.split("=")
    longest = {"distance": expected["longest_gap_m"], "time": expected["longest_gap_s"], "frames": 0.0}[kind]
    if images_known and abs(expected["judged_share"] - 0.99) > 1e-9 and abs(longest - float(value)) > 1e-9:
        assert (made.incomplete is not None) == (expected["judged_share"] < 0.99 or longest > float(value))


def test_one_percent_of_the_images_may_be_missing() -> None:
    for count, whole in ((4, True), (5, False)):
        keep = np.delete(np.arange(COUNT), 20 * np.arange(1, count + 1))
        full = straight()
        part = Trajectory(full.stamps_ns[keep], full.positions[keep], full.quats_xyzw[keep])
        assert (covered(part, full, full).incomplete is None) == whole


def test_estimates_in_short_holes_of_a_matched_truth_are_not_judged() -> None:
    """Nothing is interpolated there, so that no figure contains their errors."""
    full, rows = straight(), np.arange(COUNT)
    kept = (rows % 5 == 0) | (rows < 100) | (rows >= 200)
    truth = Trajectory(full.stamps_ns[kept], full.positions[kept], full.quats_xyzw[kept])
    assert covered(full, truth, full).without_truth == 80
    sparse = covered(full, straight(every=5), full)  # its frames are those of the truth, as a warning says
    assert (sparse.without_truth, sparse.judged_share) == (0, 1.0)


@pytest.mark.parametrize(
    ("hole_ms", "max_gap_ms", "share"), [(800, 1000, 0.0), (800, 500, 0.08), (400, 300, 0.0), (600, 300, 0.06)]
)
def test_a_path_without_images_exceeds_the_gap_and_five_periods(hole_ms: int, max_gap_ms: int, share: float) -> None:
    """A rover drives 10 m in 10 s, with an image every 100 ms but for one hole, and true poses between the images."""
    images_ms = np.delete(np.arange(0, 10_001, 100), np.arange(31, 30 + hole_ms // 100))
    true_ms = np.arange(0, 10_001, 7)
    path = TruePath(1_000_000 * true_ms, true_ms / 1000.0)
    within = path_without_images(1_000_000 * images_ms, path, 1_000_000 * max_gap_ms)
    assert within == pytest.approx(share, abs=1e-3)


@pytest.mark.parametrize(("missing", "is_gap"), [(4, False), (5, True)])
def test_more_than_five_periods_between_estimates_are_a_gap(missing: int, is_gap: bool) -> None:
    """Four missing estimates leave five periods between their neighbours; the truth is denser, the images unknown."""
    part = straight(every=4)
    keep = np.delete(np.arange(len(part)), np.arange(50, 50 + missing))
    holed = Trajectory(part.stamps_ns[keep], part.positions[keep], part.quats_xyzw[keep])
    assert (covered(holed, straight()).incomplete is not None) == is_gap


def test_an_evident_gap_is_stated_by_the_numbers_of_the_table() -> None:
    """The truth is ten times as dense as the estimate, whose images are unknown."""
    part = straight(every=10)
    keep = np.delete(np.arange(len(part)), np.arange(15, 35))
    made = covered(Trajectory(part.stamps_ns[keep], part.positions[keep], part.quats_xyzw[keep]), straight())
    share = f"{100.0 * (1.0 - made.missing_share):.4g} % of the true poses"
    assert made.longest_gap_m == pytest.approx(2.1)
    assert made.incomplete is not None
    assert made.incomplete.startswith(f"the estimate covers {share}, and its longest gap is 2.1 m and 21 s")


def test_a_gap_that_is_evident_without_limits_is_one_with_limits() -> None:
    """The truth has no pose in the gap, so that no true pose lacks its estimate."""
    full = straight()
    keep = np.delete(np.arange(COUNT), np.arange(141, 156))
    holed = Trajectory(full.stamps_ns[keep], 1.01 * full.positions[keep], full.quats_xyzw[keep])
    config = TrajectoryScoreConfig(conditions=("distance=2",), spacing=1)
    score = as_score(score_trajectory(Estimates.of(holed), straight(every=20), config))
    limits = [{"condition": "distance=2", "chord_mean_m": 1.0}]
    rules = [None, parse_limits({"trajectory": limits}, "limits")]
    allowed = parse_limits({"trajectory": limits, "completeness": {"missing_max_share": 0.1}}, "limits")
    assert score.number("missing") == 0.0
    assert score.number("longest_gap", part="time") == pytest.approx(1.6)
    texts = [judged_by(score, each).incomplete for each in rules]
    assert texts[0] is not None
    assert texts[0] == texts[1]
    assert "pass" not in [item.state for item in judged_by(score, rules[1]).verdicts]
    assert [judged_by(score, allowed).incomplete, judged_by(score, rules[1], partial=True).incomplete] == [None, None]


def test_stamps_that_a_file_has_rounded_cover_their_images() -> None:
    images, dense = straight(every=5), straight()
    for every, share in ((5, 1.0), (10, 0.5)):
        poses = straight(every=every)
        rounded = Trajectory(poses.stamps_ns + 100_000_000, poses.positions, poses.quats_xyzw)  # a fifth of a period
        found = covered(rounded, dense, images)
        assert found.judged_share == pytest.approx(share, abs=0.01)
        assert (found.incomplete is None) == (share == 1.0)


def test_a_tenth_of_the_stamps_with_other_poses_is_two_runs() -> None:
    whole = straight()
    for count, is_refused in ((30, False), (50, True)):
        again = straight(last=count)
        moved = again.positions + np.array([5.0, 0.0, 0.0])
        stamps = np.concatenate([whole.stamps_ns, again.stamps_ns])
        quats = np.concatenate([whole.quats_xyzw, again.quats_xyzw])
        both = Trajectory(stamps, np.concatenate([whole.positions, moved]), quats)
        if is_refused:
            with pytest.raises(MetricsError, match="two runs"):
                single_run_stamps(both, "estimate")
        else:
            assert len(single_run_stamps(both, "estimate")) == COUNT


def test_a_tenth_of_the_true_stamps_with_other_poses_is_two_truths() -> None:
    whole, again = straight(), straight(last=50)
    parts = ((whole.stamps_ns, again.stamps_ns), (whole.positions, again.positions + 5.0))
    both = Trajectory(*map(np.concatenate, (*parts, (whole.quats_xyzw, again.quats_xyzw))))
    with pytest.raises(MetricsError, match="the ground truth contains two runs: 50 of its 451 poses"):
        covered(whole, both)


def test_results_are_due_once_they_may_not_take_longer() -> None:
    stamps = np.arange(11) * SECOND
    none = np.empty(0, np.int64)
    assert due_stamps(stamps, none, 3 * SECOND).tolist() == stamps[:8].tolist()
    assert due_stamps(stamps, stamps[:10], 3 * SECOND).tolist() == stamps[:10].tolist()
    assert due_stamps(stamps, none, 0).tolist() == stamps.tolist()


def values_of(rows: Iterable[Figure]) -> dict[str, float | None]:
    return {" ".join(filter(None, (row.figure, row.part))): row.value for row in rows}


@pytest.mark.clause("4.3.4")
def test_rows_of_a_map_by_hand() -> None:
    rows = values_of(
        map_completeness(
            points=90,
            not_finite=10,
            without_truth=9,
            point_pairs=np.array([0, 0, 1]),
            expected_pairs=3,
            uncovered=[0.2, 0.7, 0.1],
        )
    )
    assert rows == {
        **{"judged map": 2 / 3, "pairs_without_cloud": 1 / 3, "pairs_without_cloud count": 1},
        **{"points_without_truth": 0.1, "points_without_truth count": 9},
        **{"points_not_finite": 0.1, "points_not_finite count": 10, "pixels_without_point": 0.7},
        **{"points_repeated": 0.0, "points_repeated count": 0.0},
    }


@pytest.mark.clause("4.2.1")
def test_rows_of_calls_by_hand() -> None:
    """Of five pairs two were measured, one of them twice; two calls of one stamp are of another run."""
    expected = np.arange(5) * SECOND
    given = np.array([0, 0, 1, 2, 77, 77]) * SECOND
    seconds = np.array([0.1, 0.1, 0.1, np.nan, 0.1, 0.1])
    rows = values_of(calls_completeness(CallKind.LOCALISATION, given, expected, {Scope.CALLS: seconds}))
    part = " localisation"
    shares = {"judged calls": 2 / 5, "calls_missing": 3 / 5, "calls_other": 2 / 5, "calls_doubled": 1 / 5}
    assert rows == {f"{name}{part}": value for name, value in shares.items()}
    other = values_of(calls_completeness(CallKind.FUSION, given[-1:], expected, {Scope.CALLS: seconds[-1:]}))
    assert other["judged calls fusion"] == 0.0, "a call for a set is at a stamp of the source, too"


@pytest.mark.clause("4.2.1")
def test_several_calls_near_one_pair_are_doubled() -> None:
    """Calls within 0.4 periods of their pair belong to the pair, whatever their stamps."""
    expected = np.arange(5) * SECOND
    beside = np.concatenate((expected, expected[:2] + SECOND // 5, expected[2:3] - SECOND // 5))
    for called, doubled in ((np.sort(beside), 3 / 8), (expected + SECOND // 5, 0.0)):
        measured = {Scope.CALLS: np.full(len(called), 0.1)}
        rows = values_of(calls_completeness(CallKind.LOCALISATION, called, expected, measured))
        shares = [rows[f"{name} localisation"] for name in ("calls_missing", "calls_other", "calls_doubled")]
        assert shares == [0.0, 0.0, doubled]


@pytest.mark.parametrize(("late_ns", "wrong"), [(1, 0.0), (1000, 0.0), (1001, 1.0)])
def test_the_call_of_a_single_pair_may_have_a_rounded_stamp(late_ns: int, wrong: float) -> None:
    expected = np.array([SECOND])
    rows = values_of(calls_completeness(CallKind.MAPPING, expected + late_ns, expected, {Scope.CALLS: np.array([0.1])}))
    assert (rows["calls_missing mapping"], rows["calls_other mapping"]) == (wrong, wrong)


def test_rows_of_a_live_run_by_hand() -> None:
    rows = values_of(live_completeness(90, 10, 2, 3))
    counts = {"dropped count": 10, "restarts": 2, "publisher_changes": 3}
    assert rows == {"judged live": 0.9, "dropped": 0.1, **counts}


@pytest.mark.parametrize(("count", "missing", "is_incomplete"), [(100, 1, False), (200, 2, False), (100, 2, True)])
def test_exactly_one_percent_of_missing_images_is_not_evident(count: int, missing: int, is_incomplete: bool) -> None:
    stamps_ns = np.arange(count) * 10**8
    positions = np.column_stack((0.1 * np.arange(count), np.zeros((count, 2))))
    truth = Trajectory(stamps_ns, positions, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))
    estimate = truth[np.delete(np.arange(count), [10, 30][:missing])]
    config = TrajectoryScoreConfig(conditions=("distance=5",))
    scored = score_trajectory(Estimates.of(estimate), truth, config, image_stamps_ns=stamps_ns)
    assert (judged_by(as_score(scored), None).incomplete is not None) == is_incomplete


def test_of_two_true_poses_with_one_stamp_the_last_is_used_throughout() -> None:
    """The path of completeness and the interpolation error are those of the truth without the first poses."""
    truth = straight(0, 100)
    wrong = Trajectory(truth.stamps_ns[20:22], truth.positions[20:22] + 1.0, truth.quats_xyzw[20:22])
    parts = [(each.stamps_ns, each.positions, each.quats_xyzw) for each in (wrong, truth)]
    doubled = Trajectory(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    paths = [true_path(each, truth.stamps_ns, 0).travelled_m for each in (doubled, truth)]
    np.testing.assert_array_equal(*paths)
    between_ns = truth.stamps_ns[:-1] + SECOND // 20
    np.testing.assert_array_equal(*(interpolation_errors(each, between_ns) for each in (doubled, truth)))
    frames = associate(truth, doubled, AssociationConfig())[0]
    np.testing.assert_array_equal(spline_positions(doubled, frames), spline_positions(truth, frames))


def bursts(count: int = 300) -> np.ndarray:
    """Stamps of images with the intervals 1, 1 and 0.35 s."""
    return np.cumsum(np.tile([1.0, 1.0, 0.35], count) * SECOND).astype(np.int64)


@pytest.mark.clause("4.1.1")
def test_an_estimate_covers_one_image_of_a_burst() -> None:
    """Images that are less than 0.4 typical periods apart require one estimate each."""
    images_ns = bursts()
    positions = np.column_stack((0.05e-9 * images_ns, np.zeros((len(images_ns), 2))))
    full = Trajectory(images_ns, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(images_ns), 1)))
    is_first = np.diff(images_ns, prepend=0) > SECOND // 2
    for estimate, judged_share in ((full, 1.0), (full[np.flatnonzero(is_first)], 2.0 / 3.0)):
        made = covered(estimate, full, full)
        assert made.matched == len(estimate)
        assert (made.judged_share, made.missing) == (pytest.approx(judged_share), len(full) - len(estimate))
        assert (made.incomplete is None) == (judged_share == 1.0)


@pytest.mark.clause("4.2.1")
def test_a_call_belongs_to_one_pair_of_a_burst() -> None:
    expected = bursts()
    is_first = np.diff(expected, prepend=0) > SECOND // 2
    for called, missing in ((expected, 0.0), (expected[is_first], 1.0 / 3.0)):
        measured = {Scope.CALLS: np.full(len(called), 0.1)}
        rows = values_of(calls_completeness(CallKind.LOCALISATION, called, expected, measured))
        assert rows["calls_missing localisation"] == pytest.approx(missing)
        assert rows["calls_other localisation"] == rows["calls_doubled localisation"] == 0.0


@pytest.mark.parametrize("name", ["standing_max_share", "errors_beyond_max_share"])
def test_a_drive_without_sub_trajectories_meets_no_limit_on_their_fractions(name: str) -> None:
    scored = score_trajectory(Estimates.of(straight(0, 30)), straight(0, 30), TrajectoryScoreConfig(("distance=500",)))
    score = judged_by(as_score(scored), parse_limits({"completeness": {name: 0.1}}, "limits"))
    assert [(item.value, item.state) for item in score.on_limits] == [(None, "not enough data")]


@pytest.mark.parametrize(("length_m", "is_enough"), [(25, False), (30, True)])
def test_the_drive_that_the_template_of_limits_names_is_long_enough(length_m: int, is_enough: bool) -> None:
    """25 m in steps of 0.1 m have fewer than five independent sub-trajectories of 5 m, and 30 m have five."""
    drive = straight(0, 100 * length_m + 1, 10)
    scored = as_score(score_trajectory(Estimates.of(drive), drive, TrajectoryScoreConfig()))
    assert ((scored.figure("position").independent or 0.0) >= INDEPENDENT_FOR_VERDICT) == is_enough


@pytest.mark.parametrize("count", [0, 50])
def test_a_live_run_without_true_poses_covers_no_true_pose(count: int) -> None:
    """Without any message, nothing is known to be missing."""
    estimates = Estimates.of(straight(0, count))
    score = as_score(score_trajectory(estimates, straight(0, 0), TrajectoryScoreConfig(), is_live=True))
    assert score.number("in_gaps") == (1.0 if count else None)
    limits = parse_limits({"trajectory": [{"condition": "distance=5", "position_mean_m": 1}]}, "limits")
    for rules in (limits, None):
        judged = judged_by(score, rules)
        assert "covers" not in (judged.incomplete or "")
        assert (judged.verdict is None) == (rules is None and not count)


@pytest.mark.parametrize("gap_m", [0, 30, 90])
@pytest.mark.parametrize("condition", ["distance=5", "time=5", "displacement=5"])
def test_a_gap_of_the_estimate_does_not_make_a_moving_rover_stationary(gap_m: int, condition: str) -> None:
    """A rover on a bend at 1 m/s along x. The estimates have a gap and are otherwise exact."""
    drive = straight(0, 2001, 1)
    x = 1e-9 * drive.stamps_ns
    positions = np.column_stack((x, np.sin(x), 0.1 * np.sin(2.0 * x)))
    truth = Trajectory(drive.stamps_ns, positions, drive.quats_xyzw)
    is_estimated = np.abs(positions[:, 0] - 0.5 * positions[-1, 0]) >= 0.5 * gap_m
    estimate = truth[is_estimated]
    scored = as_score(score_trajectory(Estimates.of(estimate), truth, TrajectoryScoreConfig((condition,))))
    assert scored.number("standing", condition=condition, part="sub-trajectories") == 0.0
    copied = scored.figure("errors_of_truth")
    judged = scored.figure("position", condition=condition)
    assert (copied.n, copied.value) == (judged.n, 1.0)
