"""The proposed configuration of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from helpers.made_worlds import make_world
from helpers.message_bags import write_messages
from sfr_loc_map.io.bag import messages
from sfr_loc_map.source_setup.proposal import propose_config


def test_a_recording_without_images_has_a_proposal(tmp_path: Path) -> None:
    """No topic is searched for the missing images, whatever the names of the topics are."""
    message = messages.odometry(1, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    place = write_messages(tmp_path / "x", [("/loc/left/None", 1, message)])
    assert propose_config(place, {}).missing


def raw_stereo(path: Path) -> Path:
    """Write raw images whose right header stamps are 40 ms late, and camera_info without a baseline."""
    rig = make_world().loc_rig
    image = np.zeros((rig.height, rig.width), np.uint8)
    entries = []
    for recorded_ns in range(10**9, 2 * 10**9, 10**8):
        for side, late_ns in (("left", 0), ("right", 40_000_000)):
            info = messages.camera_info(recorded_ns + late_ns, rig, "loc", side)
            info.p[3] = 0.0
            entries.append((f"/loc/{side}/camera_info", recorded_ns, info))
            message = messages.image(recorded_ns + late_ns, image, "loc", side)
            entries.append((f"/loc/{side}/image_raw", recorded_ns, message))
    return write_messages(path, entries)


def test_a_given_baseline_is_not_missing(tmp_path: Path) -> None:
    place = raw_stereo(tmp_path / "x")
    assert any("calibration.baseline_m" in text for text in propose_config(place, {}).missing)
    given = propose_config(place, {"calibration": {"baseline_m": 0.12}}).missing
    assert given
    assert not any("calibration.baseline_m" in text for text in given)


def test_the_stamps_are_compared_as_the_source_uses_them(tmp_path: Path) -> None:
    place = raw_stereo(tmp_path / "x")
    assert propose_config(place, {}).sections["sync"] == {"right_offset_s": -0.04}
    for given in ({"stamps": "record"}, {"right_offset_s": -0.039}, {"stamp_tolerance_s": 0.045}):
        assert propose_config(place, {"sync": given}).sections["sync"] == given
