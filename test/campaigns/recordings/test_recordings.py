"""Recordings in the formats of various drivers and tools contain the drive of the sample."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaigns.recordings.bags import Recording, add_static, nav_sat_fix
from campaigns.recordings.drive import Drive, load_drive
from campaigns.recordings.rows import ROWS, Made
from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.source_config import SourceConfig, source_config
from sfr_loc_map.io.truth.messages import enu_m
from sfr_loc_map.source_setup.examination import propose_config

SHORT = 12


@pytest.fixture(scope="session")
def drive() -> Drive:
    return load_drive(SHORT)


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


CAMERA = ("width", "height", "fx", "fy", "cx", "cy", "baseline_m")
BLURRED = {
    "compressed_jpeg": 4.0,
    "bayer": 7.0,
    "bayer_png": 7.0,
    "ros_yaml": 5.0,
    "grey_12_bit": 0.6,
    "grey_10_bit": 0.1,
}
"""Mean difference, grey levels, of images that are compressed, mosaics, of another bit depth, or rectified again."""
OTHER_FOCAL = ("kalibr_yaml", "opencv_yaml", "image_folder")
"""Recordings for which cv2.stereoRectify chooses a focal length without black borders."""


def sections_of(made: Made) -> dict[str, Any]:
    """Return the settings that the owner adds to a recording."""
    sections: dict[str, Any] = {}
    for name, value in made.settings.items():
        section, _, key = name.partition(".")
        sections.setdefault(section, {})[key] = value
    if made.calibration is not None:
        sections.setdefault("calibration", {})["file"] = str(made.calibration)
    return sections


@pytest.mark.clause("3.2.6")
@pytest.mark.parametrize("name", ROWS)
def test_a_recording_is_read_as_proposed_and_not_without(drive: Drive, tmp_path: Path, name: str) -> None:
    if name == "cut_short":
        drive = load_drive()  # long enough to keep complete chunks
    made = ROWS[name].make(tmp_path, drive)
    file = tmp_path / "mine" / "sfr.yaml"
    proposal = propose_config(made.source, Configuration(file, sections_of(made)))
    assert not proposal.missing
    file.parent.mkdir()
    file.write_text(proposal.text())
    config = source_config(made.source, file)
    assert config == proposal.config
    source = open_source(made.source, config)
    assert source.loc is not None
    pairs = list(source.loc.pairs())
    assert len(pairs) == len(drive.images) or (name == "cut_short" and len(pairs) > 25)
    assert [pair.stamp_ns for pair in pairs] == drive.stamps_ns[: len(pairs)]
    assert source.loc.rig.T_rb_sb is not None
    assert np.allclose(source.loc.rig.T_rb_sb.matrix, drive.rig.T_rb_sb.matrix, atol=1e-12)  # type: ignore[union-attr]
    if name not in OTHER_FOCAL:
        assert [getattr(source.loc.rig, f) for f in CAMERA] == [getattr(drive.rig, f) for f in CAMERA]
        for pair, (left, right) in zip(pairs, drive.images, strict=False):
            for read, taken in ((pair.left, left), (pair.right, right)):
                off = np.abs(read.astype(np.int16) - taken).mean()
                assert off <= BLURRED.get(name, 0.0), name
    truth = source.loc.ground_truth
    assert isinstance(truth, Trajectory)
    assert len(truth) >= len(pairs) - 1
    if "pan_tilt" in name:
        assert source.nav is not None
        heads = [item.T_lm_navsb for item in source.nav.pairs()]
        for read_pose, item in zip(heads, drive.nav, strict=True):  # LM is RB here, so only relative poses are compared
            turn = heads[0].inverse() @ read_pose
            assert np.allclose(turn.matrix, (drive.nav[0].T_lm_navsb.inverse() @ item.T_lm_navsb).matrix, atol=1e-6)
    if name not in ("plain", "truth_file"):
        with pytest.raises(InputError, match=r"sfr info|sfr init|trigger both"):
            open_source(made.source, SourceConfig())
