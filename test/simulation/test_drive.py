"""Poses of the rover and of its cameras: frame conventions, and positions that were computed by hand."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, radians, sin
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.extrinsics import mast_head_in_rb
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.drive import Leg, legs_of
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.rover import GROUND_HEIGHT_RB_M
from sfr_loc_map.suite_names import Task

Maker = Callable[..., SimulationConfig]

STEADY = {
    "drive__vibration_deg": 0.0,
    "drive__vibration_m": 0.0,
    "drive__sway_m": 0.0,
    "drive__sway_deg": 0.0,
    "drive__slip": 0.0,
    "drive__start_heading_deg": 0.0,
}
FLAT = {
    "terrain__relief_m": 0.0,
    "terrain__hills_m": 0.0,
    "terrain__ripple_height_m": 0.0,
    "terrain__crater_density": 0.0,
}


@pytest.mark.clause("3.2.1")
def test_origin_stands_0_540_m_above_flat_ground(config: Maker) -> None:
    plan = Plan.make(config(**FLAT, **STEADY))
    for time in (0.0, 1.0, 2.0):
        pose = plan.drive.pose(time)
        assert pose.translation[2] == pytest.approx(0.540, abs=1e-9)
        assert np.allclose(pose.rotation[2], [0, 0, 1], atol=1e-9)


@pytest.mark.clause("3.2.1")
def test_origin_stands_0_540_m_from_a_slope_along_its_normal(config: Maker) -> None:
    plan = Plan.make(config(**FLAT, **STEADY, terrain__slope_deg=12.0))
    pose = plan.drive.pose(1.0)
    normal = np.array([-math.sin(math.radians(12)), 0.0, math.cos(math.radians(12))])
    assert pose.translation @ normal == pytest.approx(0.540, abs=2e-4)
    assert pose.rotation[:, 2] @ normal == pytest.approx(1.0, abs=1e-6)
    assert pose.rotation[2, 0] == pytest.approx(math.sin(math.radians(12)), abs=1e-3)  # x points up the slope


@pytest.mark.parametrize(
    ("segments", "end", "heading"),
    [
        (["straight 2"], (2, 0), 0),
        (["turn 90", "straight 2"], (0, 2), 90),
        (["arc 2 90"], (2, 2), 90),
        (["arc -2 90"], (2, -2), -90),
        (["arc 2 -90"], (-2, 2), -90),  # backwards on the circle to the left
        (["straight 1", "goto 1 3", "goto 1 3"], (1, 3), 90),
    ],
)
def test_the_path_of_a_drive_ends_at_the_end_of_its_segments(
    config: Maker, segments: list[str], end: tuple[float, float], heading: float
) -> None:
    drive = Plan.make(config(**FLAT, **STEADY, drive__segments=segments)).drive
    pose = drive.pose(drive.duration_s)
    assert np.allclose(pose.translation[:2], end, atol=1e-6)
    assert math.degrees(math.atan2(pose.rotation[1, 0], pose.rotation[0, 0])) == pytest.approx(heading, abs=1e-6)


@pytest.mark.clause("3.2.5", "3.2.6")
def test_pan_to_the_left_turns_the_view_to_the_left(config: Maker) -> None:
    plan = Plan.make(
        config(**FLAT, **STEADY, panorama__enabled=True, panorama__pan_deg=[0.0, 30.0], panorama__tilt_deg=[20.0, 20.0])
    )
    ahead, left = (plan.lm_pose(k).rotation[:, 0] for k in (0, 1))
    assert ahead == pytest.approx([math.cos(math.radians(20)), 0, -math.sin(math.radians(20))], abs=1e-9)
    assert math.degrees(math.atan2(left[1], left[0])) == pytest.approx(30.0, abs=1e-9)
    assert plan.count(Task.MAPPING) == 2


@pytest.mark.clause("3.2.5", "3.2.7.2")
def test_pose_of_the_cameras_in_lm_is_the_hand_computed_pose(config: Maker) -> None:
    """LM is on the ground below RB, with x along the heading. In RB, the tilt axis is at (0.451, 0.317, 0.594) m and
    the ground at z = -0.540 m. At tilt 30, NAVSB is 0.06 cos 30 + 0.08 sin 30 m ahead of the tilt axis and
    -0.06 sin 30 + 0.08 cos 30 m above; at pan 90, ahead is along y."""
    start = {"drive__start_x_m": 3.0, "drive__start_y_m": -2.0, "drive__start_heading_deg": 90.0}
    plan = Plan.make(
        config(**FLAT, **STEADY | start, panorama__enabled=True, panorama__pan_deg=[90.0], panorama__tilt_deg=[30.0])
    )
    pose = plan.lm_pose(0)
    half, long = 0.5, math.sqrt(0.75)
    assert pose.translation == pytest.approx([0.451, 0.317 + 0.0919615, 0.540 + 0.594 + 0.0392820], abs=1e-6)
    assert pose.rotation == pytest.approx(np.array([[0, -1, 0], [long, 0, half], [-half, 0, long]]), abs=1e-9)


@pytest.mark.parametrize(
    "segment",
    [
        "fly 3",
        "straight",
        "arc 2",
        "straight x",
        "",
        "turn nan",
        "stop 0",
        "stop -5",
        "straight 0",
        "turn 0",
        "arc 0 90",
    ],
)
def test_unknown_segment_is_refused(config: Maker, segment: str) -> None:
    with pytest.raises(ConfigError, match=r"drive\.segments"):
        Plan.make(config(drive__segments=[segment]))


def test_sizes_of_rocks_without_a_rock_are_refused(config: Maker) -> None:
    with pytest.raises(ConfigError, match=r"rocks\.smallest_m"):
        Plan.make(config(rocks__cover=0.05, rocks__smallest_m=2.0, rocks__largest_m=1.5))


@pytest.mark.parametrize(
    ("segments", "away"),
    [
        (["straight 401"], "401"),
        (["arc 1000 360"], "2e+03"),
        (["arc -1000 -360"], "2e+03"),
        (["arc 250 180", "straight 1"], "500"),
        (["arc 401 720"], "802"),
        (["goto 0 500", "goto 0 0"], "500"),
    ],
)
def test_path_that_leaves_the_ground_is_refused_although_it_may_end_on_the_ground(
    config: Maker, segments: list[str], away: str
) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"drive.segments go {away} m away from the start")):
        Plan.make(config(**FLAT, **STEADY, drive__segments=segments))


def test_circle_within_the_allowed_distance_is_driven(config: Maker) -> None:
    legs = legs_of(config(**FLAT, **STEADY, drive__segments=["arc 199 360"]).drive)
    assert legs == [Leg(pytest.approx(199 * 2 * math.pi), pytest.approx(2 * math.pi))]


@pytest.mark.parametrize(
    ("segment", "slip", "duration_s"),
    [
        ("straight 150", 0.0, 150.0),
        ("straight 150", 0.2, 150.0 / 0.8),
        ("straight -150", 0.2, 150.0 / 0.8),
        ("arc 50 -172", 0.2, 150.0 / 0.8),
        ("turn 3000", 0.2, 150.0 / 0.8),
        ("stop 150", 0.2, 150.0),
    ],
)
def test_slip_makes_a_drive_longer_by_its_mean(config: Maker, segment: str, slip: float, duration_s: float) -> None:
    speeds = {"drive__speed_m_s": 1.0, "drive__turn_rate_deg_s": 20.0}
    settings = FLAT | STEADY | speeds | {"drive__segments": [segment], "drive__slip": slip}
    assert Plan.make(config(**settings)).drive.duration_s == pytest.approx(duration_s, rel=0.05)


@pytest.mark.parametrize(
    ("changes", "is_allowed"),
    [
        ({"drive__segments": ["stop 20000"]}, True),
        ({"drive__segments": ["stop 15000", "stop 5001"]}, False),
        ({"drive__segments": ["stop 1e300"]}, False),
        ({"drive__segments": ["turn 1e9"]}, False),
        ({"drive__segments": ["straight 100"], "drive__speed_m_s": 0.006}, True),
        ({"drive__segments": ["straight 100"], "drive__speed_m_s": 0.006, "drive__slip": 0.2}, False),
    ],
)
def test_a_drive_whose_states_do_not_fit_into_memory_is_refused(
    config: Maker, changes: dict[str, Any], *, is_allowed: bool
) -> None:
    settings = config(**FLAT, **STEADY | changes).drive
    if is_allowed:
        assert legs_of(settings)
    else:
        with pytest.raises(ConfigError, match=r"drive\.segments take .* at most 20000 s"):
            legs_of(settings)


def test_too_many_pairs_are_refused(config: Maker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sfr_loc_map.simulation.plan.MAX_DRIVE_PAIRS", 1000)
    with pytest.raises(ConfigError, match=r"1001 pairs: at most 1000 .* drive\.period_s"):
        Plan.make(config(**FLAT, **STEADY, drive__segments=["stop 1000"], drive__period_s=1.0))


def test_a_configuration_that_was_not_checked_is_refused() -> None:
    light = replace(SimulationConfig().light, sun_elevation_deg=-20.0)
    with pytest.raises(ConfigError, match=r"light\.sun_elevation_deg"):
        Plan.make(replace(SimulationConfig(), light=light))


def test_a_disabled_drive_is_not_checked_and_its_rover_is_at_the_start(config: Maker) -> None:
    panorama = {"panorama__enabled": True, "drive__start_heading_deg": 30.0}
    drives = Plan.make(config(**panorama))
    stands = Plan.make(config(**panorama, drive__enabled=False, drive__segments=["straight 1e9"]))
    assert np.array_equal(stands.lm_pose(1).matrix, drives.lm_pose(1).matrix)
    assert np.array_equal(stands.T_ds_lm.matrix, drives.T_ds_lm.matrix)
    with pytest.raises(ConfigError, match="frame is 2"):
        stands.check_frame(Task.MAPPING, 2)


def test_a_panorama_of_more_pairs_than_a_map_has_is_refused(config: Maker) -> None:
    angles = [0.0] * 4
    with pytest.raises(ConfigError, match=r"panorama\.pan_deg has 4 pairs"):
        Plan.make(config(panorama__enabled=True, panorama__pan_deg=angles, panorama__tilt_deg=angles))


@pytest.mark.parametrize("drives", [True, False])
def test_a_panorama_without_a_pair_is_refused(config: Maker, *, drives: bool) -> None:
    panorama = {"panorama__enabled": True, "panorama__pan_deg": [], "panorama__tilt_deg": []}
    with pytest.raises(ConfigError, match=r"panorama\.pan_deg is empty"):
        Plan.make(config(**panorama, drive__enabled=drives))


def test_sway_has_the_configured_standard_deviations(config: Maker) -> None:
    """Values at intervals of 2 s are independent; between them, they are blended, which leaves 0.86 of the spread."""
    sway = {"drive__sway_m": 0.05, "drive__sway_deg": 3.0}
    settings = FLAT | STEADY | sway | {"drive__segments": ["straight 300"], "drive__speed_m_s": 0.3}
    drive = Plan.make(config(**settings)).drive
    headings = np.degrees(np.arctan2(drive.rotations[:, 1, 0], drive.rotations[:, 0, 0]))
    assert np.std(drive.origins[:, 1]) == pytest.approx(0.86 * 0.05, rel=0.1)
    assert np.std(headings) == pytest.approx(0.86 * 3.0, rel=0.1)


AXIS = np.array([0.451, 0.317, 0.594])
"""Where the tilt axis meets the x-z plane of the mast [3.2.6]: on the pan axis, so it stays there."""


@pytest.mark.clause("3.2.2", "3.2.6")
@pytest.mark.parametrize(
    ("pan", "tilt", "forward", "left"),
    [
        (0, 0, (1, 0, 0), (0, 1, 0)),
        (pi / 2, 0, (0, 1, 0), (-1, 0, 0)),  # to the left: forward becomes left, left becomes back
        (-pi / 2, 0, (0, -1, 0), (1, 0, 0)),
        (0, pi / 2, (0, 0, -1), (0, 1, 0)),  # straight down; the tilt axis does not move
        (pi / 2, pi / 2, (0, 0, -1), (-1, 0, 0)),
        (pi, 0, (-1, 0, 0), (0, -1, 0)),
        # 30 deg left, then 20 deg down about the carried axis
        (
            radians(30),
            radians(20),
            (cos(radians(20)) * cos(radians(30)), cos(radians(20)) * sin(radians(30)), -sin(radians(20))),
            (-sin(radians(30)), cos(radians(30)), 0),
        ),
    ],
)
def test_mast_head(pan: float, tilt: float, forward: tuple[float, ...], left: tuple[float, ...]) -> None:
    T_rb_head = mast_head_in_rb(pan, tilt)
    np.testing.assert_allclose(T_rb_head.apply([2, 0, 0]), AXIS + 2 * np.array(forward), atol=1e-15)
    np.testing.assert_allclose(T_rb_head.apply([0, 2, 0]), AXIS + 2 * np.array(left), atol=1e-15)
    np.testing.assert_array_equal(T_rb_head.translation, AXIS)


@pytest.mark.clause("3.2.1", "3.2.6")
def test_a_point_ahead_of_the_head_falls_on_the_ground_where_triangles_say() -> None:
    # The tilt axis is 0.594 + 0.540 = 1.134 m above the ground; 45 deg down it is reached 1.134 m ahead.
    distance = (0.594 + 0.540) * 2**0.5
    point = mast_head_in_rb(0.0, radians(45)).apply([distance, 0, 0])
    np.testing.assert_allclose(point, [0.451 + 1.134, 0.317, GROUND_HEIGHT_RB_M], atol=1e-12)
