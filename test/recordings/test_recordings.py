"""Recordings as other people's drivers and tools make them are made of the sample, and hold its drive."""

from pathlib import Path

import numpy as np
import pytest
from bags import Recording, add_static, nav_sat_fix
from drive import Drive, load_drive
from rosbags.highlevel import AnyReader
from rows import ROWS

from sfr_loc_map.geometry.transform import FrameTree, Transform
from sfr_loc_map.io.truth import enu_m


@pytest.fixture(scope="session")
def drive() -> Drive:
    return load_drive()


@pytest.mark.parametrize("links", [1, 2, 5])
def test_the_frames_of_a_driver_lead_to_the_left_camera(drive: Drive, links: int) -> None:
    recording, tree = Recording(), FrameTree()
    add_static(recording, drive, ["base_link", *(f"link_{k}" for k in range(links)), "left_optical"])
    for edge in recording.messages[0][2].transforms:
        move, turn = edge.transform.translation, edge.transform.rotation
        pose = Transform.from_quat((move.x, move.y, move.z), (turn.x, turn.y, turn.z, turn.w))
        tree.add(edge.header.frame_id, edge.child_frame_id, pose)
    found = tree.find("base_link", "left_optical")
    assert found is not None
    assert np.allclose(found.matrix, drive.rig.T_rb_left.matrix, atol=1e-12)


def test_fixes_are_the_positions_that_the_truth_reads_from_them() -> None:
    places = np.array([[0.0, 0.0, 0.0], [3.0, -40.0, 0.7], [250.0, 90.0, -4.0]])
    fixes = [nav_sat_fix(None, place, 0.01) for place in places]
    read = enu_m(np.array([(fix.latitude, fix.longitude, fix.altitude) for fix in fixes]))
    assert np.allclose(read, places, atol=1e-6)


def test_each_recording_is_made_and_holds_the_drive(drive: Drive, tmp_path: Path) -> None:
    for name, row in ROWS.items():
        folder = tmp_path / name
        folder.mkdir()
        source = row.make(folder, drive).source
        if name in ("cut_short", "mcap_with_foreign_schemas"):
            continue  # the library refuses them
        with AnyReader([source]) as bag:
            images = [c for c in bag.connections if "Image" in c.msgtype]
            whole = [c for c in images if c.msgcount in (len(drive.images), len(drive.nav))]
            assert len(whole) == len(images) >= 1, name
