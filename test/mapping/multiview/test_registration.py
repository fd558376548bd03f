"""Registration: known pose errors are recovered, implausible ones left, views without overlap untouched."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.multiview.pose_agreement import MIN_OVERLAP
from sfr_loc_map.mapping.multiview.registration import PoseCorrection, estimate_correction, register_views
from sfr_loc_map.mapping.multiview.view import View


def with_error(view: View, error: Transform) -> View:
    """Return a view whose pose errs by a motion in its left optical frame."""
    return view.with_pose(view.T_lm_left @ error)


def motion(rotation_deg: tuple[float, ...], translation_m: tuple[float, ...]) -> Transform:
    return Transform(matrix_from_rotvec(np.deg2rad(rotation_deg)), np.array(translation_m, float))


@pytest.mark.parametrize(
    ("rotation_deg", "translation_m"),
    [
        ((0, 0, 0), (0, 0, 0)),
        ((0, 0, 1), (0, 0, 0)),
        ((1, 0, 0), (0, 0, 0)),
        ((0, -1, 0), (0, 0, 0)),
        ((0.3, -0.6, 0.4), (0.01, 0.0, -0.01)),
    ],
)
def test_pose_errors_are_recovered(
    two_views: Any, rotation_deg: tuple[float, ...], translation_m: tuple[float, ...]
) -> None:
    first, second = two_views.views
    registered = register_views([first, with_error(second, motion(rotation_deg, translation_m))], two_views.rig)
    rest = second.T_lm_left.inverse() @ registered.views[1].T_lm_left
    assert np.rad2deg(np.linalg.norm(rotvec_from_matrix(rest.rotation))) < 0.05
    assert np.linalg.norm(rest.translation) < 0.003
    expected = np.linalg.norm(rotation_deg)
    assert registered.statistics["pose_turned_deg_1"] == pytest.approx(expected, abs=0.05)
    assert registered.statistics["pose_moved_m_1"] == pytest.approx(np.linalg.norm(translation_m), abs=0.003)
    assert not registered.warnings


def test_the_points_move_with_the_pose(two_views: Any) -> None:
    first, second = two_views.views
    error = motion((0.2, 0.3, -0.1), (0.0, 0.01, 0.0))
    moved = register_views([first, with_error(second, error)], two_views.rig).views[1]
    local = moved.T_lm_left.inverse().apply(moved.cloud.xyz)
    np.testing.assert_allclose(local, second.T_lm_left.inverse().apply(second.cloud.xyz), atol=1e-5)
    np.testing.assert_allclose(moved.cloud.xyz, second.cloud.xyz, atol=0.01)


def test_the_first_pose_and_those_without_overlap_stay(two_views: Any) -> None:
    first, second = two_views.views
    away = with_error(second, motion((0, 0, 0), (0.0, 300.0, 0.0)))
    registered = register_views([first, away], two_views.rig)
    assert registered.views[0] is first
    assert registered.views[1] is away
    assert not registered.statistics
    assert estimate_correction([first], away, two_views.rig) is None


def test_a_pose_beyond_the_bounds_is_left_with_a_warning(two_views: Any) -> None:
    first, second = two_views.views
    wrong = with_error(second, motion((0, 0, 2.6), (0, 0, 0)))
    registered = register_views([first, wrong], two_views.rig)
    assert registered.views[1] is wrong
    assert any("left as given" in line for line in registered.warnings)
    assert registered.statistics["pose_turned_deg_1"] == pytest.approx(2.6, abs=0.1)


def test_a_correction_states_angle_and_length() -> None:
    correction = PoseCorrection(motion((0.0, 1.5, 2.0), (0.03, 0.0, -0.04)))
    assert correction.rotation_deg == pytest.approx(2.5)
    assert correction.translation_m == pytest.approx(0.05)
    assert not correction.is_plausible
    assert PoseCorrection(motion((0.0, 1.0, 1.0), (0.0, 0.0, 0.09))).is_plausible
    assert not PoseCorrection(motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.11))).is_plausible


def test_too_few_points_give_no_correction(two_views: Any) -> None:
    first, second = two_views.views
    few = replace(second, cloud=second.cloud.select(np.arange(MIN_OVERLAP // 2)))
    assert estimate_correction([first], few, two_views.rig) is None
