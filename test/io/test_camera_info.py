"""Rigs through camera_info."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from made_worlds import START_NS

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.bag_messages import camera_info
from sfr_loc_map.io.camera_info import baseline_from_projection, message_baseline, rig_from_camera_info

focal = st.floats(10, 5000)


@given(focal, st.integers(1, 10**6))
def test_baselines_in_micrometres_are_exact(fx: float, micrometres: int) -> None:
    baseline = micrometres / 1e6
    assert baseline_from_projection(fx, -(fx * baseline)) == baseline


@given(focal, focal, st.floats(0.001, 10))
def test_rigs_of_files_come_through_messages_unchanged(fx: float, fy: float, baseline: float) -> None:
    rig = message_baseline(StereoRig(80, 60, fx, fy, 33.3, 22.2, baseline))
    assert abs(rig.baseline_m - baseline) <= 4e-16 * baseline
    infos = [camera_info(START_NS, rig, "loc", side) for side in ("left", "right")]
    assert rig_from_camera_info(*infos, "loc").same_cameras(rig)
