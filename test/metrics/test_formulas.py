"""Each formula by hand, and the laws that errors of sub-trajectories keep; `helpers.metrics_reference` repeats them."""

import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sfr_loc_map.metrics import formulas, other_formulas
from sfr_loc_map.metrics.formulas import Poses

NO_TURN = np.array([0.0, 0.0, 0.0, 1.0])


def poses(seed: int = 5, count: int = 60, size: float = 0.2) -> Poses:
    """Random true poses, and estimates that differ by some degrees and decimetres."""
    rng = np.random.default_rng(seed)
    truth = Rotation.random(count, random_state=seed)
    estimate = truth * Rotation.from_rotvec(size * rng.uniform(-1, 1, (count, 3)))
    position = rng.normal(0, 5, (count, 3))
    return Poses(position, truth.as_quat(), position + size * rng.normal(size=(count, 3)), estimate.as_quat())


@pytest.mark.clause("4.1.2")
def test_errors_do_not_depend_on_the_world_frame_of_the_estimate() -> None:
    """Re-based by the whole pose, a rotated and shifted world changes nothing."""
    given_poses = poses()
    world = Rotation.random(random_state=9)
    moved = world.apply(given_poses.position) + np.array([3.0, -2.0, 1.0])
    turned = (world * Rotation.from_quat(given_poses.attitude)).as_quat()
    elsewhere = given_poses._replace(position=moved, attitude=turned)
    starts, ends = np.arange(0, 30), np.arange(30, 60)
    for here, there in zip(
        formulas.pose_reading(given_poses, starts, ends), formulas.pose_reading(elsewhere, starts, ends), strict=True
    ):
        np.testing.assert_allclose(here, there, atol=1e-10)
    change = formulas.displacement_reading(elsewhere, starts, ends).attitude_deg
    np.testing.assert_allclose(change, formulas.displacement_reading(given_poses, starts, ends).attitude_deg, atol=1e-9)
    here, there = (formulas.position_reading(each, starts, ends).position_m for each in (given_poses, elsewhere))
    assert np.abs(here - there).max() > 1.0


def test_errors_by_direction() -> None:
    """North is forward: an error to the east is to the right, which is minus cross."""
    errors = np.array([[1.0, 2.0, 5.0], [1.0, 2.0, 5.0]])
    displacements, headings = np.array([[0.0, 3.0, 1.0], [0.0, 0.0, 9.0]]), np.array([0.1, 0.8])
    along, cross = other_formulas.along_and_cross(errors, displacements, headings)
    assert (along[0], cross[0]) == (2.0, -1.0)
    assert along[1] == pytest.approx(math.cos(0.8) + 2.0 * math.sin(0.8)), "no direction: the heading"
    assert cross[1] == pytest.approx(2.0 * math.cos(0.8) - math.sin(0.8))


@pytest.mark.clause("4.2.3.3")
def test_heading_is_that_of_the_forward_axis_and_errors_are_wrapped() -> None:
    turns = Rotation.random(50, random_state=4)
    x, y, _ = turns.apply([1.0, 0.0, 0.0]).T
    np.testing.assert_allclose(formulas.heading(turns.as_quat()), np.arctan2(y, x), atol=1e-12)
    for angle, wrapped in ((0, 0), (180, 180), (-180, 180), (181, -179), (540, 180), (-359, 1), (-179, -179)):
        error = formulas.heading_error_deg(np.radians(np.array([angle])), np.zeros(1))
        assert error == pytest.approx(wrapped, abs=1e-9)
    assert formulas.heading_error_deg(np.array([0.3]), np.array([0.1]))[0] > 0.0, "estimated less actual"
    lowest = np.nextafter(-np.pi, 0.0)
    assert formulas.heading_error_deg(np.array([lowest]), np.zeros(1))[0] == np.degrees(lowest), "kept to the bit"


@pytest.mark.clause("4.2.3.2")
def test_an_attitude_error_is_the_shortest_angle_whatever_the_signs_of_the_quaternions() -> None:
    rng = np.random.default_rng(2)
    actual = Rotation.random(200, random_state=1)
    angles = np.concatenate((np.full(50, 1e-10), rng.uniform(0.0, math.pi, 150)))
    axes = rng.normal(size=(200, 3))
    turn = Rotation.from_rotvec(axes / np.linalg.norm(axes, axis=1)[:, None] * angles[:, None])
    signs = rng.choice([-1.0, 1.0], (200, 1))
    found = formulas.attitude_error_deg(signs * (actual * turn).as_quat(), actual.as_quat())
    np.testing.assert_allclose(found, np.degrees(angles), rtol=1e-5, atol=1e-13)


@pytest.mark.clause("4.1.1")
def test_ends_are_the_first_frames_at_which_a_condition_holds() -> None:
    positions = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0], [1.0, 1.0, 0], [1.0, 1.0, 2.0]])
    length = formulas.path_length_m(positions)
    assert length.tolist() == [0.0, 1.0, 2.0, 2.0, 4.0]
    starts = np.arange(5)
    assert formulas.ends_by_distance(starts, length, 2.0).tolist() == [2, 4, 4, 4, 5]
    assert formulas.ends_by_distance(starts, length, 1.0 + 1e-10).tolist() == [1, 2, 4, 4, 5], "a rounding error"
    assert formulas.ends_by_distance(starts, length, 1.0 + 1e-8).tolist() == [2, 4, 4, 4, 5]
    stamps = np.array([0, 10, 20, 20, 45], np.int64) + 2**62
    assert formulas.ends_by_time(starts, stamps, 20).tolist() == [2, 4, 4, 4, 5]
    assert formulas.ends_by_frames(starts, 3).tolist() == [3, 4, 5, 6, 7]
    assert formulas.start_frames(25, 10).tolist() == [0, 10, 20]


@settings(max_examples=50)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.5, 2.0]), st.sampled_from([0.0, 20.0, 90.0]))
def test_ends_apart_are_those_of_a_loop(seed: int, metres: float, turn_deg: float) -> None:
    rng = np.random.default_rng(seed)
    positions = np.cumsum(rng.normal(0, 0.4, (40, 3)), axis=0)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.2, (40, 3)), axis=0))
    starts = np.arange(0, 40, 3)
    quats = turns.as_quat() * rng.choice([-1.0, 1.0], (40, 1))
    found = other_formulas.ends_apart(starts, np.minimum(starts + 1, 40), positions, quats, metres, turn_deg)
    for start, end in zip(starts.tolist(), found.tolist(), strict=True):
        wanted = next(
            (
                k
                for k in range(start + 1, 40)
                if math.dist(positions[k], positions[start]) >= metres
                and math.degrees((turns[start].inv() * turns[k]).magnitude()) >= turn_deg
            ),
            40,
        )
        assert end == wanted
    unknown = np.full_like(quats, np.nan)
    of_positions = other_formulas.ends_apart(starts, np.minimum(starts + 1, 40), positions, unknown, metres, turn_deg)
    assert of_positions.tolist() == (found.tolist() if turn_deg == 0.0 else [40] * len(starts))


@pytest.mark.parametrize("metres", [0.05, 1.0, 3.0, 7.0])
@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 170.0])
def test_frames_that_the_search_skips_do_not_meet_the_condition(metres: float, turn_deg: float) -> None:
    """Paths on which an end is reached exactly, late, or never: a line far from the origin, a circle, a stop."""
    steps = np.concatenate((np.full(60, 0.1), np.zeros(20), np.full(60, -0.1), np.full(60, 0.25)))
    line = np.cumsum(steps)[:, None] * [0.6, 0.0, 0.8] + [4e5, 5e6, 300.0]
    angle = np.linspace(0.0, 4.0 * np.pi, len(steps))
    circle = 3.5 * np.column_stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)))
    quats = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0]).as_quat()
    starts = np.arange(0, len(steps), 7)
    for positions in (line, circle, line[::-1]):
        found = other_formulas.ends_apart(starts, starts + 1, positions, quats, metres, turn_deg)
        for start, end in zip(starts.tolist(), found.tolist(), strict=True):
            later = np.arange(start + 1, len(steps))
            distance = np.linalg.norm(positions[later] - positions[start], axis=1)
            motions = Rotation.from_quat(quats[start]).inv() * Rotation.from_quat(quats[later])
            turned = np.degrees(motions.magnitude())
            is_met = (distance >= metres - 1e-9) & (turned >= turn_deg * (1.0 - 1e-9))
            assert end == (later[is_met][0] if is_met.any() else len(steps))


@pytest.mark.parametrize("turn_deg", [1e-7, 1e-4, 0.1, 5.0, 179.0])
def test_small_turns_are_resolved_and_a_stationary_rover_does_not_turn(turn_deg: float) -> None:
    starts = np.zeros(1, np.int64)
    about = np.array([0.6, 0.0, 0.8])
    steps = Rotation.from_rotvec(np.radians(turn_deg) * np.array([0.0, 0.5, 0.99, 1.0, 1.001])[:, None] * about)
    first = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    quats = (first * steps).as_quat()
    rest = np.zeros((5, 3))
    found = other_formulas.ends_apart(starts, starts + 1, rest, quats, 0.0, turn_deg)
    assert found.tolist() == [3 if turn_deg > 1e-6 else found[0]]
    assert found[0] >= 3
    stationary = other_formulas.ends_apart(starts, starts + 1, rest, quats[[0] * 5], 0.0, turn_deg)
    assert stationary.tolist() == [5]


def test_a_point_at_or_behind_the_camera_has_no_disparity() -> None:
    depth = np.array([2.0, 0.0, -3.0, 4.0, 4.0])
    true = np.array([4.0, 4.0, 4.0, 0.0, -1.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = other_formulas.disparity_error(100.0, 0.2, depth, true)
    assert found[0] == 100.0 * 0.2 / 2.0 - 100.0 * 0.2 / 4.0
    assert np.isnan(found[1:]).all()


@pytest.mark.clause("4.1.3", "4.2.3.1")
def test_the_mean_of_vectors_is_a_norm_of_means_and_sigma_a_norm_of_sigmas() -> None:
    """Two opposite errors: the mean vector is zero, though each is 1 m long."""
    got = formulas.statistics(np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]))
    assert (got.n, got.mean, got.rmse, got.p50, got.max) == (2, 0.0, 1.0, 1.0, 1.0)
    assert got.sigma == pytest.approx(math.sqrt(2.0)), "n - 1"
    assert got.mean_plus_3sigma == pytest.approx(3.0 * math.sqrt(2.0))
    errors = np.random.default_rng(1).normal([0.1, -0.2, 0.3], [1.0, 2.0, 3.0], (500, 3))
    got = formulas.statistics(errors)
    assert got.mean == pytest.approx(math.hypot(*errors.mean(axis=0)), rel=1e-12)
    assert got.sigma == pytest.approx(math.hypot(*errors.std(axis=0, ddof=1)), rel=1e-12)


@pytest.mark.clause("4.1.3")
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_statistics_by_numpy(offset: float) -> None:
    values = np.random.default_rng(4).normal(size=101) - offset
    got = formulas.statistics(values)
    assert (got.n, got.mean) == (101, pytest.approx(np.mean(values), rel=1e-12))
    assert got.sigma == pytest.approx(np.std(values + offset, ddof=1), rel=1e-9)
    assert got.mean_plus_3sigma == pytest.approx(abs(np.mean(values)) + 3 * np.std(values, ddof=1))
    sizes = np.abs(values)
    assert (got.p50, got.p95, got.p99) == pytest.approx(tuple(np.percentile(sizes, (50, 95, 99))))
    assert (got.rmse, got.max) == pytest.approx((math.sqrt(np.mean(sizes**2)), sizes.max()))
    one = formulas.statistics(values[:1])
    assert (one.n, one.mean, one.sigma, one.mean_plus_3sigma) == (1, values[0], None, None)
    assert formulas.statistics(np.array([1.0, np.nan])).mean is None
    assert formulas.statistics(np.empty((0, 3))) == formulas.Statistics(n=0)


@pytest.mark.clause("4.3.4")
def test_a_point_error_is_a_distance() -> None:
    actual, estimated = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]), np.array([[1.0, 5.0, 7.0], [0.0, 0.0, 0.0]])
    assert formulas.point_error(estimated, actual).tolist() == [5.0, 0.0]


def test_an_unknown_error_leaves_its_count_and_no_statistic() -> None:
    some = np.array([0.1, np.nan, 0.3])
    found = formulas.statistics(some)
    assert (found.n, found.unknown, found.mean, found.max) == (2, 1, None, None)
    vectors = formulas.statistics(np.array([[0.1, 0.2, 0.3], [0.1, np.nan, np.nan]]))
    assert (vectors.n, vectors.unknown, vectors.mean) == (1, 1, None)
