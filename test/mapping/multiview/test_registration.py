"""Registration: known pose errors are recovered, implausible ones left, views without overlap untouched."""

from typing import Any

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.multiview.registration import register_views
from sfr_loc_map.mapping.pair_view import PairView


def with_error(view: PairView, error: Transform) -> PairView:
    """Return a view whose pose errs by a motion in its left optical frame."""
    return view.with_pose(view.T_lm_left @ error)


def motion(rotation_deg: tuple[float, ...], translation_m: tuple[float, ...]) -> Transform:
    return Transform(matrix_from_rotvec(np.deg2rad(rotation_deg)), np.array(translation_m, float))


@pytest.mark.parametrize(
    ("rotation_deg", "translation_m"),
    [((0, 0, 0), (0, 0, 0)), ((1, 0, 0), (0, 0, 0)), ((0, -1, 0), (0, 0, 0)), ((0.3, -0.6, 0.4), (0.01, 0.0, -0.01))],
)
def test_pose_errors_are_recovered(
    two_views: Any, rotation_deg: tuple[float, ...], translation_m: tuple[float, ...]
) -> None:
    first, second = two_views.views
    wrong = with_error(second, motion(rotation_deg, translation_m))
    views, findings = register_views([first, wrong], two_views.rig)
    rest = second.T_lm_left.inverse() @ views[1].T_lm_left
    assert np.rad2deg(np.linalg.norm(rotvec_from_matrix(rest.rotation))) < 0.05
    assert np.linalg.norm(rest.translation) < 0.003
    assert findings.statistics["pose_turned_deg_1"] == pytest.approx(np.linalg.norm(rotation_deg), abs=0.05)
    assert findings.statistics["pose_moved_m_1"] == pytest.approx(np.linalg.norm(translation_m), abs=0.003)
    assert not findings.warnings
    local = views[1].T_lm_left.inverse().apply(views[1].points.xyz)
    np.testing.assert_allclose(local, second.T_lm_left.inverse().apply(second.points.xyz), atol=1e-5)


def test_poses_without_overlap_or_beyond_the_bounds_stay(two_views: Any) -> None:
    first, second = two_views.views
    away = with_error(second, motion((0, 0, 0), (0.0, 300.0, 0.0)))
    views, findings = register_views([first, away], two_views.rig)
    (warning,) = findings.warnings
    assert views == [first, away]
    assert "pair 1 has too few points in common" in warning
    assert not findings.statistics
    wrong = with_error(second, motion((0, 0, 2.6), (0, 0, 0)))
    views, findings = register_views([first, wrong], two_views.rig)
    (warning,) = findings.warnings
    assert views == [first, wrong]
    assert "left as given" in warning
    assert findings.statistics["pose_turned_deg_1"] == pytest.approx(2.6, abs=0.1)
